"""Files of other versions are called so, damaged ones are not."""

import json

import pytest
from pydantic import BaseModel

from deepfsi.base.errors import InputError, as_input_error, other_version


class Model(BaseModel, extra="forbid"):
    schema_version: int = 3


@pytest.mark.parametrize(
    ("facts", "said"), [({"schema": 2}, "has schema 2"), ({"schema_version": 4}, "has schema 4")]
)
def test_a_file_of_another_schema_is_called_so(facts, said):
    text = json.dumps(facts | {"unknown": 1})
    reading = as_input_error("f.json", "do it again", text, schema=3)
    with pytest.raises(InputError, match=f"^f.json {said}, .* do it again, or upgrade"), reading:
        Model.model_validate_json(text)


@pytest.mark.parametrize("text", ['{"schema": 3, "unknown": 1}', "[]", "{"])
def test_a_damaged_file_is_of_no_other_version(text):
    assert other_version(text, 3) == ""
