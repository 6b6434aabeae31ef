"""Recipes and the trials that they plan."""

import numpy as np
import pytest

from deepfsi.datasets.load import load_dataset
from shared.trials import planned


def test_a_count_that_a_design_cannot_have_is_replaced_by_its_most(digits):
    assert {trial.job.masks for trial in planned(digits, designs="lda", masks=(20, 40))} == {9}


@pytest.mark.parametrize(
    "change",
    [
        {"photons": (2e2, 1e3)},
        {"levels": 2},
        {"draws": 2},
        {"light": "free-dwell"},
        {"readout": "both"},
        {"test_noise": "ml_gauss"},
        {"training": {"epochs": 2, "lr": 1e-3}},
    ],
)
def test_every_setting_changes_the_key(digits, change):
    before = {trial.key for trial in planned(digits)}
    after = {trial.key for trial in planned(digits, **change)}
    assert len(after - before) >= len(before) / 2


def test_other_data_changes_the_key(digits):
    other = load_dataset("digits", rescale=(0.1, 1.0))
    keys = [{trial.key for trial in planned(data)} for data in (digits, other)]
    assert not keys[0] & keys[1]


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"designs": ("deepfsi", "control"), "span": 10.0}, "leave out control"),
        ({"designs": "control", "noise": "gaussian"}, "photon noise"),
        ({"designs": "raster", "light": "two-arm"}, "nothing to compare: raster .*two-arm"),
        ({"masks": (4, 100)}, "64"),
        ({"training": {"epochs": [1, 0]}}, "epochs"),
        ({"training": {"lr": []}}, "lr is empty"),
        ({"test_levels": (0, 1)}, "dark alone"),
    ],
)
def test_what_cannot_be_trained_is_refused_before_any_work(digits, settings, told):
    with pytest.raises(ValueError, match=told):
        planned(digits, **settings)


def test_repeated_values_of_an_axis_count_once(digits):
    assert len(planned(digits, designs="pca", masks=(3, 3), photons=(1e3, 1e3))) == 1


def test_designs_that_a_constraint_rules_out_are_left_out(digits):
    designs = ("raster", "pca", "hadamard", "impulse")
    two_arm = planned(digits, designs=designs, light="two-arm")
    single = planned(digits, designs=designs, rails="single")
    assert {trial.job.design for trial in two_arm} == {"pca", "hadamard", "impulse"}
    assert {trial.job.design for trial in single} == {"raster", "pca", "impulse"}


def test_the_control_group_is_for_photon_noise(digits):
    both = planned(digits, designs=("control", "pca"), noise=("poisson", "gaussian"))
    noises = {trial.test_noise for trial in both if trial.job.design == "control"}
    assert noises == {("poisson",)}


TILES = {"light": "free-dwell", "rails": "single", "photons": 1e3}
"""Light that several detectors can have."""


@pytest.mark.parametrize("optics", [TILES, {"light": "two-arm"}])
def test_readout_is_that_in_force(digits, optics):
    """A single rail has none, and to name the usual one makes no other trial."""
    usual, told = (planned(digits, **optics, **each) for each in ({}, {"readout": "both"}))
    assert [each.key for each in usual] == [each.key for each in told]
    readout = "both" if optics["light"] == "two-arm" else "difference"
    assert {each.job.camera.readout for each in told} == {readout}


def test_mask_counts_are_those_of_a_part(digits):
    settings = {**TILES, "masks": (6, 20), "detectors": "2x2"}
    trials = planned(digits, designs=("raster", "deepfsi", "impulse"), **settings)
    found = [(each.job.design, each.job.masks, each.detectors) for each in trials]
    assert found == [("raster", 16, "2x2"), ("deepfsi", 6, "2x2"), ("impulse", 64, "1x1")]


def test_a_ratio_is_of_readouts(digits):
    settings = {**TILES, "masks": (), "ratios": (0.01, 0.25, 1.0), "detectors": ("1x1", "2x2")}
    trials = planned(digits, designs="deepfsi", **settings)
    found = [(each.detectors, each.job.masks) for each in trials]
    assert found == [*(("1x1", m) for m in (1, 16, 64)), *(("2x2", m) for m in (1, 4, 16))]


def test_a_map_of_detectors_is_known_by_its_content(digits, tmp_path):
    """Renamed it is the same, changed it is another."""
    keys = []
    for name, shift in (("a.npy", 0), ("b.npy", 0), ("a.npy", 8)):
        np.save(tmp_path / name, np.roll(np.arange(64) // 32, shift))
        trials = planned(digits, **TILES, detectors=str(tmp_path / name))
        assert {each.detectors for each in trials} == {str(tmp_path / name)}
        keys.append([each.key for each in trials])
    assert keys[0] == keys[1]
    assert not set(keys[0]) & set(keys[2])
