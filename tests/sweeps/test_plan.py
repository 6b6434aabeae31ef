"""Recipes and the trials that they plan."""

import numpy as np
import pytest

from deepfsi.base import InputError
from deepfsi.datasets import load_dataset
from deepfsi.sweeps import check_settings, plan_trials
from shared.trials import small


def test_a_count_that_a_design_cannot_have_is_replaced_by_its_most(digits):
    assert small(designs="lda", masks=(20, 40)).mask_counts("lda", digits) == [9]


@pytest.mark.parametrize("change", [{"nested": 2}, {"span": 10.0}])
def test_a_control_group_that_cannot_be_trained_is_refused_before_any_work(digits, change):
    recipe = small(designs=("deepfsi", "control"), **change)
    with pytest.raises(InputError, match="leave out control"):
        plan_trials(recipe, digits)


@pytest.mark.parametrize(
    "change",
    [
        {"photons": (2e2, 1e3)},
        {"training": {"epochs": 3}},
        {"levels": 2},
        {"draws": 2},
        {"validation": 100},
        {"light": "free-dwell"},
        {"readout": "both"},
        {"noise": "gaussian"},
        {"test_noise": "ml_gauss"},
        {"tuned": {"deepfsi": {"lr": 1e-3}, "pca": {"lr": 1e-3}}},
    ],
)
def test_every_setting_changes_the_key(digits, change):
    before = {trial.key for trial in plan_trials(small(), digits)}
    after = {trial.key for trial in plan_trials(small(**change), digits)}
    assert len(after - before) >= len(before) / 2


def test_other_data_changes_the_key(digits):
    other = load_dataset("digits", rescale=(0.1, 1.0))
    keys = [{trial.key for trial in plan_trials(small(), data)} for data in (digits, other)]
    assert not keys[0] & keys[1]


@pytest.mark.parametrize(
    ("settings", "parts"),
    [
        ({"training": {"epochs": [1, 0], "lr": -1, "start": "nope"}}, ("epochs", "lr", "start")),
        ({"training": {"lr": []}}, ("lr is empty",)),
        ({"photons": [[1e3, 1e4]]}, ("photons",)),
    ],
)
def test_mistakes_in_axes_are_all_told(settings, parts):
    with pytest.raises(ValueError, match=parts[0]) as error:
        small(**settings)
    assert all(part in str(error.value) for part in parts)


def test_repeated_values_of_an_axis_count_once(digits):
    assert len(plan_trials(small(designs="pca", masks=(3, 3), photons=(1e3, 1e3)), digits)) == 1


def test_designs_that_a_constraint_rules_out_are_left_out(digits):
    designs = ("raster", "pca", "hadamard", "impulse")
    two_arm = plan_trials(small(designs=designs, light="two-arm"), digits)
    single = plan_trials(small(designs=designs, rails="single"), digits)
    assert {trial.job.design for trial in two_arm} == {"pca", "hadamard", "impulse"}
    assert {trial.job.design for trial in single} == {"raster", "pca", "impulse"}


def test_more_masks_than_pixels_are_refused(digits):
    with pytest.raises(InputError, match="64"):
        plan_trials(small(masks=(4, 100)), digits)


def test_the_control_group_is_for_photon_noise(digits):
    both = plan_trials(small(designs=("control", "pca"), noise=("poisson", "gaussian")), digits)
    noises = {trial.test_noise for trial in both if trial.job.design == "control"}
    assert noises == {("poisson",)}
    with pytest.raises(InputError, match="photon noise"):
        plan_trials(small(designs="control", noise="gaussian"), digits)


def test_a_design_that_cannot_be_had_is_refused_before_any_work(digits):
    with pytest.raises(ValueError, match="two-arm with a single rail"):
        small(light="two-arm", rails="single")
    with pytest.raises(InputError, match=r"nothing to compare: raster cannot be had.*two-arm"):
        plan_trials(small(designs="raster", light="two-arm"), digits)


TILES = {"light": "free-dwell", "rails": "single", "photons": 1e3}
"""Light that several detectors can have."""


def test_readout_is_that_in_force(digits):
    """A single rail has none, and to name the usual one makes no other trial."""
    single = [plan_trials(small(**TILES, **each), digits) for each in ({}, {"readout": "both"})]
    assert [each.key for each in single[0]] == [each.key for each in single[1]]
    usual, told = (
        plan_trials(small(light="two-arm", **each), digits) for each in ({}, {"readout": "both"})
    )
    assert [each.key for each in usual] == [each.key for each in told]
    assert {each.job.camera.readout for each in told} == {"both"}


def test_mask_counts_are_those_of_a_part(digits):
    settings = {**TILES, "masks": (6, 20), "detectors": "2x2"}
    trials = plan_trials(small(designs=("raster", "deepfsi", "impulse"), **settings), digits)
    found = [(each.job.design, each.job.masks, each.detectors) for each in trials]
    assert found == [("raster", 16, "2x2"), ("deepfsi", 6, "2x2"), ("impulse", 64, "1x1")]


def test_a_ratio_is_of_readouts(digits):
    settings = {**TILES, "masks": (), "ratios": (0.01, 0.25, 1.0), "detectors": ("1x1", "2x2")}
    trials = plan_trials(small(designs="deepfsi", **settings), digits)
    found = [(each.detectors, each.job.masks) for each in trials]
    assert found == [*(("1x1", m) for m in (1, 16, 64)), *(("2x2", m) for m in (1, 4, 16))]


def test_a_map_of_detectors_is_known_by_its_content(digits, tmp_path):
    """Renamed it is the same, changed it is another."""
    keys = []
    for name, shift in (("a.npy", 0), ("b.npy", 0), ("a.npy", 8)):
        np.save(tmp_path / name, np.roll(np.arange(64) // 32, shift))
        trials = plan_trials(small(**TILES, detectors=str(tmp_path / name)), digits)
        assert {each.detectors for each in trials} == {str(tmp_path / name)}
        keys.append([each.key for each in trials])
    assert keys[0] == keys[1]
    assert not set(keys[0]) & set(keys[2])


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"light": "column", "detectors": "2x2"}, ["column is other optics"]),
        (
            {"light": "free-dwell", "detectors": ["9x9", "none.npy"]},
            ["do not divide scenes of 8x8", "none.npy"],
        ),
    ],
)
def test_detectors_that_cannot_be_had_are_all_told(digits, settings, told):
    with pytest.raises(InputError) as error:
        check_settings({"camera": settings}, lambda recipe: digits)
    assert all(part in str(error.value) for part in told)
