"""Values of options are parsed, and what is none is refused."""

import pytest

from deepfsi.cli.options import seconds
from deepfsi.errors import InputError


@pytest.mark.parametrize(
    ("text", "value"),
    [("0.01", 0.01), ("10ms", 0.01), ("44us", 44e-6), ("44 µs", 44e-6), ("1e-3s", 1e-3)],
)
def test_times_have_units(text, value):
    assert seconds("dwell", text) == pytest.approx(value)


@pytest.mark.parametrize("text", ["", "ms", "-1", "nan", "inf", "1 hour"])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(InputError, match="--dwell"):
        seconds("dwell", text)
