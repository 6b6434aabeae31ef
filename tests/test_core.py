"""A core of laws for `make quick`: each design, light law and exposure, a photon file, a queue.

What these tests find is found again, and more exactly, by those of the folders.
"""

import numpy as np
import pytest
import torch

import deepfsi
from deepfsi.hardware.photons import PtuWriter, read_markers, summarise
from deepfsi.jobs import DESIGNS
from deepfsi.optics import constraints
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.run import compare

pytestmark = pytest.mark.core

FEW = deepfsi.Training(epochs=2, hidden=(16,), batch=100, lr=1e-2)
GUESSING = 0.15
"""Accuracy on digits that guessing has in less than one of 10⁵ tests of 360 scenes."""


def check(design, digits, photons=1e5):
    """Hold a design against the laws of light, and against guessing."""
    [result] = deepfsi.evaluate(design, digits, photons, draws=1)
    assert result.accuracy > GUESSING
    assert result.throughput <= 1 + constraints.SLACK
    assert constraints.excess(design.rails.stacked, design.light) <= constraints.SLACK


@pytest.mark.parametrize(
    "name",
    [name for name, code in DESIGNS.items() if not (code.is_custom or code.adaptive)],
)
def test_each_design_learns_digits_and_counts_no_more_light_than_there_is(digits, name):
    code = DESIGNS[name]
    masks = code.counts(digits.image_shape, 10)[1] if code.fixed_count else 8
    check(
        deepfsi.learn(digits, design=name, masks=masks, photons=1e5, camera="paper", training=FEW),
        digits,
    )


def test_adaptive_masks_know_digits_and_count_no_more_light_than_there_is(digits):
    few = digits.hold_out(1300)
    made = deepfsi.learn(few, design="adaptive", masks=4, photons=1e5, camera="dmd")
    [result] = deepfsi.evaluate(made, few, 1e5, draws=1)
    assert result.accuracy > GUESSING
    assert result.throughput <= 1 + constraints.SLACK


@pytest.mark.parametrize("light", ["equal-dwell", "free-dwell", "two-arm"])
def test_each_light_law_of_a_device_is_obeyed(digits, light):
    camera = {"light": light}
    check(deepfsi.learn(digits, masks=8, photons=1e5, camera=camera, training=FEW), digits)


@pytest.mark.parametrize(
    "exposure",
    [{"span": 10}, {"nested": 4}, {"looks": 3}],
    ids=["range", "nested", "looks"],
)
def test_each_kind_of_exposure_learns_digits(digits, exposure):
    made = deepfsi.learn(
        digits, masks=8, photons=1e5, camera="dmd", exposure=exposure, training=FEW
    )
    check(made, digits)


def test_patches_learn_digits(digits):
    made = deepfsi.learn(
        digits,
        masks=16,
        photons=1e6,
        camera="paper",
        exposure=deepfsi.Patches(patch=4),
        training={"epochs": 3},
    )
    check(made, digits, 1e6)


def test_a_seed_gives_the_same_design(digits):
    one, other = (
        deepfsi.learn(digits, masks=6, photons=1e4, training=FEW, seed=5) for _ in range(2)
    )
    assert torch.equal(one.rails.stacked, other.rails.stacked)


def test_a_queue_trains_each_trial_once(digits, tmp_path):
    recipe = Recipe(designs="pca", masks=(4, 8), photons=1e4, training={"epochs": 1}, draws=1)
    results, records = compare(recipe, digits, tmp_path, command="test")
    again, same = compare(recipe, digits, tmp_path, command="test")
    assert [point.accuracy for point in results.points] == [p.accuracy for p in again.points]
    assert records == same
    assert len(list((tmp_path / "trials").iterdir())) == 2


def test_a_photon_file_is_read_back(tmp_path):
    times = np.cumsum(np.random.default_rng(0).integers(1, 2**30, 2000))
    codes_of = np.where(np.arange(2000) % 50 == 0, -1, 0).astype(np.int16)
    with PtuWriter(tmp_path / "a.ptu") as writer:
        writer.write(times, codes_of)
    found = summarise(tmp_path / "a.ptu")
    assert (found.photons, found.markers, found.problems) == ({0: 1960}, {1: 40}, ())
    assert np.array_equal(read_markers(tmp_path / "a.ptu")[0], times[codes_of < 0])
