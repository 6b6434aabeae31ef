"""Designs for light that fluctuates from frame to frame: what training for it is worth."""

from dataclasses import replace

import numpy as np
import pytest

import deepfsi
from deepfsi import Camera, Training
from deepfsi.base import InputError
from deepfsi.evaluation import check_playable

PHOTONS = 1e6
"""At which σ² r of a readout, some 8e4 of them, is far above its photon noise."""


def accuracy(design: deepfsi.Design, fluctuation: float) -> tuple[float, int]:
    """Accuracy under light that fluctuates so, and its test scenes."""
    [result] = deepfsi.evaluate(design, "digits", PHOTONS, fluctuation=fluctuation, draws=3)
    return result.accuracy, result.images


@pytest.mark.usefixtures("uncharacterised")
@pytest.mark.parametrize("rails", ["single", "dual"])
def test_masks_that_learn_under_fluctuating_light_are_better_under_it(rails):
    """By five standard errors of the two test results, of scenes alone."""
    designs = [
        deepfsi.learn(
            "digits",
            photons=PHOTONS,
            masks=12,
            camera=Camera(light="equal-dwell", rails=rails, fluctuation=fluctuation),
            training=Training(epochs=20),
        )
        for fluctuation in (0.0, 0.1)
    ]
    (steady, scenes), (trained, _) = (accuracy(each, 0.1) for each in designs)
    error = ((steady * (1 - steady) + trained * (1 - trained)) / scenes) ** 0.5
    assert trained > steady + 5 * error
    assert accuracy(designs[0], 0.0)[0] > steady + 5 * error  # it is the light


@pytest.mark.parametrize(
    "camera",
    [
        Camera(light="two-arm", fluctuation=0.1),
        Camera(light="equal-dwell", detectors="2x2", readout="both", fluctuation=0.1),
    ],
)
def test_a_design_keeps_its_light_and_tests_counts_of_it(tmp_path, camera):
    """Sound counts of its light pass; those of steady light are told by a design for that."""
    design = deepfsi.learn(
        "digits", photons=1e4, masks=4, camera=camera, training=Training(epochs=1)
    )
    design.save(tmp_path / "d.safetensors")
    kept = deepfsi.load_design(tmp_path / "d.safetensors")
    assert kept.camera.fluctuation == 0.1
    assert kept.distribution is not None
    assert float(kept.distribution.fluctuation) == pytest.approx(0.1)
    scenes = deepfsi.load_dataset("digits").x_test[:60]
    counts = design.expose(scenes, 1e6, seed=1)
    assert not kept.consistency(counts, 1e6).refused
    steady = replace(kept.distribution, fluctuation=np.array(0.0))
    assert replace(kept, distribution=steady).consistency(counts, 1e6).refused
    with pytest.raises(InputError, match="a page draws photon and dark counts of steady light"):
        check_playable(kept)
