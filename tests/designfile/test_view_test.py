"""Test of the view of a run: its law, false alarms, power, and its place in a design's file."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from conftest import quick
from deepfsi import Design
from deepfsi.designfile import SceneModel, SceneReadouts, ViewTest, view_test
from deepfsi.designfile.view_test import FALSE_ALARM, orientation_faults, view_faults

SHAPE, PHOTONS, MASKS = (8, 8), 1e4, 16


@pytest.fixture(scope="module")
def model(digits):
    return SceneModel.fit(digits.x_train, digits.y_train, 10)


@pytest.fixture(scope="module")
def masks(digits):
    """Blocks of 2 x 2 pixels, each for an equal part of the time, counts of a white pixel."""
    blocks = np.kron(np.eye(MASKS).reshape(MASKS, 4, 4), np.ones((2, 2))).reshape(MASKS, 64)
    return blocks * PHOTONS / digits.x_train.sum(axis=1).mean() / 4


def exposed(model, masks, scenes, rng, frames=0, shown=None):
    """Result of a run of scenes (S, N), behind masks, of which others may be shown in truth."""
    test = ViewTest(model, SHAPE, frames)
    none = np.zeros(len(masks))
    places = (np.arange(len(masks)), np.ones(len(masks))) if frames else (None, None)
    for x in scenes:
        read = rng.poisson((masks if shown is None else shown) @ x.clip(min=0)).astype(float)
        test.add(SceneReadouts(masks, read, none, none.astype(int), *places))
    return test.result


def chosen(digits, rng, count=40):
    return digits.x_test[rng.integers(0, len(digits.x_test), count)].astype(float)


def test_densities_are_those_of_scenes_and_noise_together():
    rng = np.random.default_rng(1)
    axes, away = rng.normal(size=(3, 7)), rng.normal(size=(2, 7))
    found = view_test._log_densities(
        np.eye(3) + axes @ axes.T, away @ axes.T, (away**2).sum(axis=1)
    )
    whole = multivariate_normal(np.zeros(7), np.eye(7) + axes.T @ axes).logpdf(away)
    np.testing.assert_allclose(found, whole + 7 / 2 * np.log(2 * np.pi))


def test_the_model_has_the_moments_of_its_scenes(digits, model):
    """To 16-bit numbers: the mean of a class, and the variance of each pixel within classes."""
    labels = digits.y_train
    wanted = digits.x_train[labels == 3].mean(axis=0)
    np.testing.assert_allclose(model.means[3], wanted, atol=1e-3)
    away = digits.x_train - model.means[labels].astype(float)
    spread = (model.axes.astype(float) ** 2).sum(axis=0) + model.rest
    np.testing.assert_allclose(spread, (away**2).sum(axis=0) / (len(away) - 10), atol=2e-3)


def test_a_likelihood_ratio_is_1_in_the_mean_of_sound_runs(model, masks):
    """The law behind the rate of false alarms, of scenes that are as the model has them.

    The mean of exp(log ratio) over 600 runs of one scene lies within 5 of its standard errors.
    """
    rng = np.random.default_rng(2)
    bright = masks * 1e3  # counts are normal, and their noise is that of the mean scene
    means, axes = (each.astype(float) for each in (model.means, model.axes))
    test_of = ViewTest(model, SHAPE)
    ratios = []
    for _ in range(600):
        x = means[rng.choice(10, p=test_of._shares)] + rng.normal(size=len(axes)) @ axes
        x = x + rng.normal(size=64) * np.sqrt(model.rest.astype(float))
        mean = bright @ (test_of._shares @ means)
        read = bright @ x + rng.normal(size=MASKS) * np.sqrt(mean)
        read = read + 0.3 * rng.normal() * mean + 0.03 * rng.normal() * mean
        test = ViewTest.__new__(ViewTest)
        test.__dict__.update(test_of.__dict__, _log=0 * test_of._log, _often=test_of._often)
        test._all_alike = view_test._AllAlike(test_of._shares)
        test.add(SceneReadouts(bright, read, np.zeros(MASKS), np.zeros(MASKS, int)))
        ratios.append(np.exp(test.result.odds))
    error = np.std(ratios, axis=0) / np.sqrt(len(ratios))
    assert (np.mean(ratios, axis=0) < 1 + 5 * error).all()


def test_sound_runs_are_let_pass_whatever_their_classes(digits, model, masks):
    """None of 35: with at most `FALSE_ALARM` each, two or more alarms have a chance of 0.014."""
    rng, alarms = np.random.default_rng(3), 0
    for _ in range(25):
        alarms += exposed(model, masks, chosen(digits, rng), rng).named
    for label in range(10):
        own = digits.x_test[digits.y_test == label].astype(float)
        scenes = own[rng.permutation(len(own))[:20]]
        alarms += exposed(model, masks, scenes, rng).named
    assert alarms <= 1


@pytest.mark.parametrize(
    "view", [*orientation_faults(SHAPE), *view_faults(SHAPE)], ids=lambda view: view.words
)
def test_each_fault_is_refused_and_named_in_40_scenes(digits, model, masks, view):
    rng = np.random.default_rng(4)
    scenes = chosen(digits, rng)
    seen = view.see(scenes.reshape(-1, *SHAPE)).reshape(scenes.shape)
    found = exposed(model, masks, seen + view.stray * scenes.mean(), rng)
    assert found.named
    assert found.likeliest == view.words
    assert view.words in found.remark


def test_two_frames_that_are_exchanged_are_named(digits, model, masks):
    rng = np.random.default_rng(5)
    order = np.arange(MASKS)
    order[[5, 10]] = 10, 5
    found = exposed(model, masks, chosen(digits, rng), rng, MASKS, masks[order])
    assert found.refused
    assert found.likeliest == "of masks whose frames 5 and 10 were exchanged"
    assert not exposed(model, masks, chosen(digits, rng), rng, MASKS).named


def test_one_scene_shown_again_and_again_is_not_refused(digits, model, masks):
    rng = np.random.default_rng(6)
    for x in chosen(digits, rng, 10):
        assert not exposed(model, masks, np.tile(x, (40, 1)), rng).refused


def test_a_short_run_says_which_faults_stay_possible_and_how_many_scenes_would_do(
    digits, model, masks
):
    rng = np.random.default_rng(7)
    short, long = (exposed(model, masks, chosen(digits, rng, n), rng) for n in (2, 200))
    assert len(short.open) > len(long.open)
    assert "2 scenes do not exclude" in short.remark
    known = [scenes for scenes in short.open.values() if np.isfinite(scenes)]
    assert min(known) > 2
    assert long.remark is None
    assert short.as_dict()["open"] == list(short.open)


def test_an_alarm_stays(digits, model, masks):
    """A run that was refused is so whatever follows."""
    rng = np.random.default_rng(8)
    test, none = ViewTest(model, SHAPE), np.zeros(MASKS)
    scenes = chosen(digits, rng, 300)
    scenes[:30] = scenes[:30].reshape(-1, 8, 8)[:, :, ::-1].reshape(-1, 64)
    for x in scenes:
        test.add(SceneReadouts(masks, rng.poisson(masks @ x).astype(float), none, none.astype(int)))
    assert test.result.evidence < -np.log(FALSE_ALARM)
    assert test.result.refused


def test_few_scenes_make_no_model(digits):
    assert SceneModel.fit(digits.x_train[:99], digits.y_train[:99], 10) is None


def test_the_file_of_a_design_keeps_the_model_and_one_without_reads(digits, tmp_path):
    design = quick(digits, masks=4, epochs=1, photons=1e4)
    again = Design.load(design.save(tmp_path / "one.safetensors"))
    for name, held in design.scene_model.arrays.items():
        np.testing.assert_array_equal(again.scene_model.arrays[name], held)
    design.scene_model = None
    assert Design.load(design.save(tmp_path / "old.safetensors")).scene_model is None


def test_a_spectrum_is_a_picture_of_one_row():
    every = (*orientation_faults((20,)), *view_faults((20,)))
    names = [view.words for view in every]
    assert "mirrored left to right" in names
    assert not any("top" in name or "degrees" in name for name in names)
    for view in every:
        assert view.see(np.ones((3, 1, 20))).shape == (3, 1, 20)
