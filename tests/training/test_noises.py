"""Designs learned and tested under camera noise, and under light that fluctuates."""

from dataclasses import replace

import numpy as np
import pytest

import deepfsi
from conftest import quick
from deepfsi import Camera
from deepfsi.base.errors import InputError
from deepfsi.evaluation.page_data import check_playable

READ = {"noise": "camera", "sigma": 50.0, "dark": 2e4}
FRAMES = {"light": "equal-dwell", "rails": "single"}


@pytest.mark.usefixtures("uncharacterised")
@pytest.mark.parametrize(
    ("photons", "draws", "camera", "disturbed"),
    [
        (1e4, 20, {"light": "column", "rails": "dual"}, READ),
        (1e6, 1, FRAMES, {"fluctuation": 0.1}),  # σ² r, of some 8e4 counts, is above photon noise
        (1e6, 1, {**FRAMES, "rails": "dual"}, {"fluctuation": 0.1}),
    ],
)
def test_masks_that_know_of_a_noise_do_better_under_it(digits, photons, draws, camera, disturbed):
    """By five standard errors of the two tests, of their draws; it is the noise that disturbs."""
    how = {"masks": 12, "epochs": 20, "mask_lr": 1e-1, "lr": 1e-2, "scale": "common"}
    aware, unaware = (
        quick(digits, photons=photons, hidden=(40, 128), camera=Camera(**camera, **more), **how)
        for more in (disturbed, {})
    )

    def accuracy(design, **noise):
        return deepfsi.evaluate(design, digits, photons, draws=draws, **noise)[0].accuracy

    best, worse = accuracy(aware, **disturbed), accuracy(unaware, **disturbed)
    trials = draws * len(digits.x_test)
    error = ((best * (1 - best) + worse * (1 - worse)) / trials) ** 0.5
    assert best > worse + 5 * error
    assert accuracy(unaware) > worse + 5 * error


@pytest.mark.parametrize(
    "camera",
    [
        Camera(light="two-arm", fluctuation=0.1),
        Camera(light="equal-dwell", detectors="2x2", readout="both", fluctuation=0.1),
    ],
)
def test_a_design_keeps_its_light_and_tests_counts_of_it(digits, tmp_path, camera):
    """Sound counts of its light pass; those of steady light are told by a design for that."""
    few = {"epochs": 1}
    design = deepfsi.learn(digits, photons=1e4, masks=4, camera=camera, training=few)
    kept = deepfsi.load_design(design.save(tmp_path / "d.safetensors"))
    assert kept.camera.fluctuation == 0.1
    assert kept.distribution is not None
    assert float(kept.distribution.fluctuation) == pytest.approx(0.1)
    counts = design.expose(digits.x_test[:60], 1e6, seed=1)
    assert not kept.consistency(counts, 1e6).refused
    steady = replace(kept.distribution, fluctuation=np.array(0.0))
    assert replace(kept, distribution=steady).consistency(counts, 1e6).refused
    with pytest.raises(InputError, match="a page draws photon and dark counts of steady light"):
        check_playable(kept)
