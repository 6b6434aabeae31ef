"""Values of options are parsed, and what is none is refused."""

import pytest

from deepfsi.base import InputError
from deepfsi.cli.options import seconds


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


@pytest.mark.parametrize("noise", ["poisson", "none"])
def test_read_noise_is_refused_where_the_noise_has_none(refuse, tmp_path, noise):
    given = ("--photons", "1e4", "--noise", noise, "--sigma", "5")
    told = refuse("design", *given, "--masks", "4", "-o", tmp_path / "made.safetensors")
    assert f"--sigma is not of {noise} noise" in told
    told = refuse("compare", *given, "--designs", "pca", "-o", tmp_path / "out")
    assert "--sigma is not of" in told


def test_read_noise_is_taken_by_the_noises_that_have_it(done, refuse, tmp_path):
    made = tmp_path / "made.safetensors"
    given = ("design", "--design", "pca", "--photons", "1e4", "--masks", "4", "--epochs", "1")
    done(*given, "--noise", "gaussian", "--sigma", "5", "-o", made)
    done("evaluate", made, "--photons", "1e4", "--noise", "camera", "--sigma", "5")
    done("evaluate", made, "--photons", "1e4")
    done("evaluate", made, "--photons", "1e4", "--sigma", "9")
    told = refuse("evaluate", made, "--photons", "1e4", "--noise", "poisson", "--sigma", "1e9")
    assert "--sigma is not of poisson noise" in told
