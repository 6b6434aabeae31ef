"""Designs for light that fluctuates from frame to frame: what training for it is worth."""

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


def test_a_design_keeps_its_light_and_has_no_test_of_counts(tmp_path):
    camera = Camera(rails="dual", fluctuation=0.1)
    design = deepfsi.learn(
        "digits", photons=1e4, masks=4, camera=camera, training=Training(epochs=1)
    )
    design.save(tmp_path / "d.safetensors")
    kept = deepfsi.load_design(tmp_path / "d.safetensors")
    assert kept.camera.fluctuation == 0.1
    assert kept.distribution is None
    assert kept.scene_model is None
    with pytest.raises(InputError, match="a page draws photon and dark counts of steady light"):
        check_playable(kept)
