"""Read noise is of the noises that have it."""

import pytest


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
