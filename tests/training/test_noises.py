"""Designs learned and tested under camera noise, and under light that fluctuates."""

from dataclasses import replace

import numpy as np
import pytest

import deepfsi
from deepfsi import Camera
from deepfsi.base.errors import InputError
from deepfsi.evaluation.page_data import check_playable


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
