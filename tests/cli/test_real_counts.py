"""`camera picture`: what a user reads, and real counts in the folder of DEEPFSI_DATA."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import hadamard

REAL = Path(os.environ.get("DEEPFSI_DATA") or ".")
COUNTER, WAVELET = REAL / "spc_photon_counter", REAL / "spc_wavelet"


def test_an_excess_of_one_run_and_of_two_is_said(done, tmp_path):
    rng, masks = np.random.default_rng(1), hadamard(256)
    for name in "ab":
        light = rng.lognormal(0, 0.1, 256)[:, None]
        mean = np.stack([(masks > 0).sum(axis=1), (masks < 0).sum(axis=1)], axis=1) * 5 * light
        np.save(tmp_path / f"{name}.npy", rng.poisson(mean))
    words = ["--masks", "hadamard-natural", "--exposures", "1ms,1ms", "--block", "16"]
    files = [tmp_path / "a.npy", tmp_path / "b.npy"]
    said = done("camera", "picture", *files, *words, "-o", tmp_path / "p")
    assert "THESE COUNTS ARE NOT POISSON" in said
    assert "of each table by itself: 10." in said or "of each table by itself: 9." in said


@pytest.mark.skipif(not COUNTER.exists(), reason="needs $DEEPFSI_DATA/spc_photon_counter")
def test_three_exposures_of_a_photon_counter(done, tmp_path):
    files = [COUNTER / f"240321_13_1024_{us}_150_0.npy" for us in (20000, 40000, 80000)]
    words = ["--masks", "hadamard-natural", "--exposures", "20ms,40ms,80ms", "--block", "64"]
    told = json.loads(done("camera", "picture", *files, *words, "-o", tmp_path / "o", "--json"))
    assert told["correlations"] == pytest.approx([0.701, 0.759, 0.824], abs=5e-4)
    assert np.ptp(told["rates"]) / np.mean(told["rates"]) < 0.01
    light = told["light"]
    first = light["runs"][0]
    assert not light["poisson"]
    assert (first["spread"], first["allowed"]) == pytest.approx((0.187, 0.0389), abs=5e-4)
    assert light["correlations"] == pytest.approx([0.930, 0.941, 0.963], abs=5e-4)
    # what looks like a lamp is optics: masks as fine as one another have the same light
    causes = light["causes"]
    assert causes["fineness"]["share"] == pytest.approx(0.961, abs=5e-4)
    assert max(causes[name]["rest"] for name in ("block", "place in block", "sequence")) < 0.05
    # and what each run has of its own is twice Poisson's variance at every exposure
    own = [1 + o["variance"] * r["mean"] for o, r in zip(light["own"], light["runs"], strict=True)]
    assert own == pytest.approx([2.11, 2.20, 2.19], abs=5e-3)


@pytest.mark.skipif(not WAVELET.exists(), reason="needs $DEEPFSI_DATA/spc_wavelet")
@pytest.mark.parametrize(("name", "agreement"), [("Haar", 0.932), ("LeGall", 0.924)])
def test_wavelet_coefficients_give_the_picture_of_the_ccd(done, tmp_path, name, agreement):
    file = WAVELET / f"Jaszczak_{name}_4_128x128.mat"
    words = ["--masks", f"wavelet-{name.lower()}-4", "--compare", f"{file}:F", "--json"]
    told = json.loads(done("camera", "picture", f"{file}:W", *words, "-o", tmp_path / "o"))
    assert told["agreement"][0]["correlation"] == pytest.approx(agreement, abs=5e-4)
    [noise] = told["wavelets"]
    assert (noise["level"], noise["reversed"], told["light"]) == (2, True, None)
    assert noise["measured"] == pytest.approx(0.25, abs=1e-3)
    assert min(noise["variance_over_poisson"]) > 40
