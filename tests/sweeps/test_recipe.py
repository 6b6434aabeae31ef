"""Parts of a recipe file, and its coarse versions."""

import pytest

from deepfsi.errors import InputError
from deepfsi.sweeps.recipe import only, parts

FILE = {
    "data": "mnist",
    "training": {"epochs": 40, "batch": 500},
    "quick": {"trials": 3, "training": {"epochs": 8}},
    "parts": {
        "one": {"training": {"decay": 2.0}},
        "two": {"data": "digits", "quick": {"training": {"epochs": 4}}},
    },
}
ONE = {"data": "mnist", "training": {"epochs": 40, "batch": 500, "decay": 2.0}}
TWO = {"data": "digits", "training": {"epochs": 40, "batch": 500}}


def test_parts_and_quick_tables_override_the_settings_of_all():
    assert parts(FILE) == {"one": ONE, "two": TWO}
    quick = parts(FILE, quick=True)
    assert quick["one"] == {**ONE, "trials": 3, "training": {**ONE["training"], "epochs": 8}}
    assert quick["two"] == {**TWO, "trials": 3, "training": {**TWO["training"], "epochs": 4}}


def test_a_part_is_asked_for_by_name():
    assert only(FILE, "two") == TWO
    assert only(ONE) == ONE


@pytest.mark.parametrize(
    ("file", "asked", "words"),
    [
        (FILE, {}, "one, two"),
        (FILE, {"part": "tow"}, "did you mean 'two'"),
        (ONE, {"part": "one"}, "no parts"),
        (ONE, {"quick": True}, "no .quick. table"),
        ({"parts": 3}, {}, r"write \[parts\]"),
        ({"parts": {"one": 3}}, {}, r"write \[one\]"),
        ({"quick": [1]}, {}, r"write \[quick\]"),
    ],
)
def test_what_a_file_does_not_have_is_refused(file, asked, words):
    with pytest.raises(InputError, match=words):
        only(file, **asked)
