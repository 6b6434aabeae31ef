"""The number of a file's schema is named before any other fault."""

import json

import pytest
from pydantic import BaseModel

from deepfsi.base.errors import InputError, as_input_error


class Model(BaseModel, extra="forbid"):
    schema_version: int = 3


def test_a_file_of_another_schema_is_called_so():
    text = json.dumps({"unknown": 1, "schema_version": "4a"})
    reading = as_input_error("f.json", "do it again")
    with (
        pytest.raises(InputError, match=r"^f.json .* at schema_version: .*; do it again$"),
        reading,
    ):
        Model.model_validate_json(text)
