"""Times and counts as people write them, and read them back."""

import numpy as np
import pytest

from deepfsi.base import count_text, seconds, time_text


@pytest.mark.parametrize(
    ("time_s", "text"),
    [(12000.0, "12000 s"),
     (0.01207, "12.07 ms"), (1e-5, "10 µs"), (1.5, "1.5 s"), (0.0, "0 s"), (20e-9, "20 ns"),
     (0.001, "1 ms"), (0.99999, "1 s"), (4.4e-5, "44 µs"), (81e-12, "81 ps"), (3600.0, "3600 s")],
)  # fmt: skip
def test_times_have_the_unit_that_suits_them(time_s, text):
    assert time_text(time_s) == text


def test_times_are_read_back():
    """To the four digits that are written."""
    for time_s in 10.0 ** np.random.default_rng(0).uniform(-11, 6, 200):
        assert seconds(time_text(time_s).replace(" ", "")) == pytest.approx(time_s, rel=6e-4)


@pytest.mark.parametrize(
    ("text", "value"),
    [("0.01", 0.01), ("10ms", 0.01), ("44us", 44e-6), ("44 µs", 44e-6), ("1e-3s", 1e-3)],
)
def test_times_have_units(text, value):
    assert seconds(text) == pytest.approx(value)


@pytest.mark.parametrize("text", ["", "ms", "-1", "nan", "inf", "1 hour"])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(ValueError, match="is not a time"):
        seconds(text)


@pytest.mark.parametrize(
    ("counts", "text"),
    [(99.9, "99.9"), (0.25, "0.25"), (1634.2, "1634"), (163421.0, "163400"), (9999.9, "10000"),
     (1.634e7, "1.63e7"), (1e6, "1e6"), (0.0, "0"), (3.0, "3"), (999.6, "1000")],
)  # fmt: skip
def test_counts_are_written_out(counts, text):
    assert count_text(counts) == text


def test_no_count_below_a_million_has_an_exponent():
    for counts in 10.0 ** np.random.default_rng(0).uniform(-3, 5.9999, 300):
        assert "e" not in count_text(counts)
        assert float(count_text(counts)) == pytest.approx(counts, rel=6e-3)
