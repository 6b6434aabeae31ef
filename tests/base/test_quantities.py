"""Times and counts as people write them, and read them back."""

import numpy as np
import pytest

from deepfsi.base.quantities import count_text, seconds, time_text


def test_times_are_read_back():
    """To the four digits that are written."""
    for time_s in 10.0 ** np.random.default_rng(0).uniform(-11, 6, 200):
        assert seconds(time_text(time_s).replace(" ", "")) == pytest.approx(time_s, rel=6e-4)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *((0.01, 0.01), (0, 0.0), ("0.01", 0.01), ("10ms", 0.01), ("44us", 44e-6)),
        *(("44 µs", 44e-6), ("1e-3s", 1e-3), ("20NS", 20e-9), ("3ps", 3e-12), ("2s", 2.0)),
    ],
)
def test_times_have_units(text, value):
    assert seconds(text) == pytest.approx(value)


@pytest.mark.parametrize("text", ["", "ms", "-1", "nan", "inf", "1 hour"])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(ValueError, match="is not a time"):
        seconds(text)


def test_no_count_below_a_million_has_an_exponent():
    for counts in 10.0 ** np.random.default_rng(0).uniform(-3, 5.9999, 300):
        assert "e" not in count_text(counts)
        assert float(count_text(counts)) == pytest.approx(counts, rel=6e-3)
