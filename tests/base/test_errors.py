"""Files of other versions: older and newer ones are called so, damaged ones are not."""

import json
from importlib.metadata import version

import pytest
from pydantic import BaseModel

from deepfsi.base.errors import InputError, as_input_error, other_version


class Model(BaseModel, extra="forbid"):
    schema_version: int = 3


HERE = version("deepfsi")


@pytest.mark.parametrize(
    ("facts", "said"),
    [
        ({"deepfsi": "0.1.0", "schema": 7}, "deepfsi 0.1.0 with schema 7, older than"),
        ({"deepfsi": HERE, "schema": 2}, "with schema 2, older than"),
        ({"deepfsi": "99.0.1.dev3"}, "deepfsi 99.0.1.dev3, newer than this one: upgrade deepfsi"),
        ({"schema_version": 4}, "a deepfsi with schema 4, newer than this one: upgrade deepfsi"),
        ({"provenance": {"deepfsi": "0.1.9"}}, "deepfsi 0.1.9, older than"),
    ],
)
def test_a_file_of_another_version_is_called_so(facts, said):
    text = json.dumps(facts | {"unknown": 1})
    reading = as_input_error("f.json", "do it again", text, schema=3)
    with pytest.raises(InputError, match=f"^f.json was written by .*{said}"), reading:
        Model.model_validate_json(text)


@pytest.mark.parametrize(
    "facts",
    [
        {"deepfsi": HERE, "schema": 3, "unknown": 1},
        {"deepfsi": "none", "schema": "x"},
        {"schema": 10**30},
        [],
    ],
)
def test_a_damaged_file_is_of_no_other_version(facts):
    assert other_version(json.dumps(facts), 3) == other_version("{", 3) == ""
