"""Recipes and the trials that they plan."""

import pytest

from deepfsi.datasets import load_dataset
from deepfsi.errors import InputError
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.trial import plan
from shared.trials import small


def test_plan_holds_every_point_once(digits):
    trials = plan(small(trials=2), digits)
    assert len({trial.key for trial in trials}) == len(trials) == 2 * 2 * 2 * 2


def test_designs_without_a_choice_of_masks_appear_once(digits):
    trials = plan(small(designs=("impulse", "raster", "hadamard"), photons=1e3), digits)
    assert [trial.job.masks for trial in trials] == [64, 64, 64]


def test_a_count_that_a_design_cannot_have_is_replaced_by_its_most(digits):
    assert small(designs="lda", masks=(20, 40)).mask_counts("lda", digits) == [9]


def test_paper_ratios_are_the_default(digits):
    counts = Recipe(designs="pca").mask_counts("pca", digits)
    assert counts == [1, 3, 6, 10, 16, 23, 31, 41, 52, 64]


@pytest.mark.parametrize(
    "change",
    [
        {"photons": (2e2, 1e3)},
        {"training": {"epochs": 3}},
        {"training": {"levels": 2}},
        {"draws": 2},
        {"validation": 100},
        {"light": "free-dwell"},
        {"noise": "gaussian"},
        {"test_noise": "ml_gauss"},
        {"tuned": {"deepfsi": {"lr": 1e-3}, "pca": {"lr": 1e-3}}},
    ],
)
def test_every_setting_changes_the_key(digits, change):
    before = {trial.key for trial in plan(small(), digits)}
    after = {trial.key for trial in plan(small(**change), digits)}
    assert len(after - before) >= len(before) / 2


def test_other_data_changes_the_key(digits):
    other = load_dataset("digits", rescale=(0.1, 1.0))
    keys = [{trial.key for trial in plan(small(), data)} for data in (digits, other)]
    assert not keys[0] & keys[1]


def test_all_mistakes_of_a_recipe_are_reported():
    with pytest.raises(ValueError, match="photons") as error:
        Recipe(photons=(-1.0,), trials=0, light="colum")
    assert {fault["loc"][0] for fault in error.value.errors()} == {"photons", "trials", "light"}


def test_gaussian_noise_may_have_budgets_of_its_own(digits):
    both = small(noise=("poisson", "gaussian"), photons=1e3, gaussian_photons=(30, 300))
    budgets = {(trial.job.noise, trial.job.photons) for trial in plan(both, digits)}
    assert budgets == {("ml_gauss", 1e3), ("gaussian", 30), ("gaussian", 300)}


def test_settings_of_masks_do_not_multiply_fixed_designs(digits):
    recipe = small(masks=3, photons=1e3, training={"epochs": 1, "start": ["pca", "random"]})
    designs = [trial.job.design for trial in plan(recipe, digits)]
    assert sorted(designs) == ["deepfsi", "deepfsi", "pca"]


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
    assert len(plan(small(designs="pca", masks=(3, 3), photons=(1e3, 1e3)), digits)) == 1


def test_impulse_imaging_is_one_reference_for_every_constraint(digits):
    recipe = small(designs="impulse", light=("column", "free-dwell"), rails=("dual", "single"))
    assert len(plan(recipe, digits)) == len(recipe.photons)


def test_designs_that_a_constraint_rules_out_are_left_out(digits):
    designs = ("raster", "pca", "hadamard", "impulse")
    two_arm = plan(small(designs=designs, light="two-arm"), digits)
    single = plan(small(designs=designs, rails="single"), digits)
    assert {trial.job.design for trial in two_arm} == {"pca", "hadamard", "impulse"}
    assert {trial.job.design for trial in single} == {"raster", "pca", "impulse"}


def test_more_masks_than_pixels_are_refused(digits):
    with pytest.raises(InputError, match="64"):
        plan(small(masks=(4, 100)), digits)


def test_the_control_group_is_for_photon_noise(digits):
    both = plan(small(designs=("control", "pca"), noise=("poisson", "gaussian")), digits)
    noises = {trial.test_noise for trial in both if trial.job.design == "control"}
    assert noises == {("poisson",)}
    with pytest.raises(InputError, match="photon noise"):
        plan(small(designs="control", noise="gaussian"), digits)


def test_a_design_that_cannot_be_had_is_refused_before_any_work(digits):
    with pytest.raises(InputError, match="two-arm"):
        plan(small(light="two-arm", rails="single"), digits)
