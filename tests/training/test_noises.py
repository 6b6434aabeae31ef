"""Designs learned and tested under camera noise, and under a noise of one's own."""

import math

import pytest

from conftest import PHOTONS, generator, light_on, quick, same
from deepfsi import Design, evaluate
from deepfsi.sweeps import Recipe, plan_trials
from shared.noises import exact, offset, photons, saturating
from shared.trials import small, train_trials

CAMERA = {"noise": "camera", "sigma": 50.0, "dark": 2e4}


def assert_standardised(design, digits, *noise, draws=20, trained=math.inf):
    """Scaled features have mean 0 and variance 1; `trained` scenes gave the design's statistics."""
    features = design.scanner(*noise)(
        light_on(design, digits.x_train).repeat(draws, 1).float(), generator()
    )
    scaled = ((features / PHOTONS - design.mean) / design.std).double()
    share = 1 / len(scaled) + 1 / trained
    assert scaled.mean(dim=0).abs().max() <= 5 * math.sqrt(share)
    fourth = scaled.pow(4).mean(dim=0)
    assert ((scaled.var(dim=0) - 1).abs() <= 5 * ((fourth - 1) * share).sqrt()).all()


@pytest.mark.parametrize("rails", ["dual", "single"])
@pytest.mark.parametrize("light", ["column", "free-dwell"])
@pytest.mark.parametrize("design", ["pca", "deepfsi"])
def test_features_are_standardised_with_dark_counts_and_read_noise(digits, design, light, rails):
    one = quick(digits, design, light=light, rails=rails, **CAMERA)
    assert_standardised(one, digits, *CAMERA.values())
    # each part is seen: without it the features are narrower, by far more than chance
    for less in (("camera", 50.0, 0.0), ("camera", 0.01, 2e4)):
        with pytest.raises(AssertionError):
            assert_standardised(one, digits, *less)


@pytest.mark.parametrize("own", [photons, saturating])
@pytest.mark.parametrize("design", ["pca", "deepfsi"])
def test_features_are_standardised_under_a_noise_of_ones_own(digits, design, own):
    one = quick(digits, design, noise=own)
    assert one.info["job"]["camera"]["noise"] == f"shared.noises:{own.__name__}"
    assert_standardised(one, digits, own, trained=len(digits.x_train))


def test_masks_that_know_of_read_noise_do_better_under_it(digits):
    """Five sigma of the noise draws, in which alone the two tests differ."""
    how = {"masks": 10, "epochs": 20, "mask_lr": 1e-1, "lr": 1e-2, "scale": "common"}
    draws = 20
    first, second = (
        evaluate(
            quick(digits, hidden=(40, 128), **how, **noise), digits, PHOTONS, draws=draws, **CAMERA
        )[0].accuracy
        for noise in (CAMERA, {"noise": "ml_gauss"})
    )
    trials = draws * len(digits.x_test)
    error = math.sqrt((first * (1 - first) + second * (1 - second)) / trials)
    assert first - second > 5 * error


def test_more_dark_counts_read_fewer_digits(good, digits):
    accuracy = [
        evaluate(good, digits, PHOTONS, noise="camera", sigma=0.01, dark=dark)[0].accuracy
        for dark in (0.0, 3e3, 1e5)
    ]
    assert accuracy[0] > accuracy[1] > accuracy[2]
    [alone] = evaluate(good, digits, PHOTONS, noise="poisson")
    assert abs(alone.accuracy - accuracy[0]) < 0.02


def test_a_noise_may_be_for_tests_alone(digits):
    one = quick(digits)
    [result] = evaluate(one, digits, PHOTONS, noise=exact)
    [wanted] = evaluate(one, digits, PHOTONS)
    assert result.noise == "shared.noises:exact"
    error = math.sqrt(2 * 0.25 / (3 * len(digits.x_test)))
    assert abs(result.accuracy - wanted.accuracy) < 5 * error


@pytest.mark.parametrize("scale", ["each", "common"])
@pytest.mark.parametrize("design", ["pca", "deepfsi"])
def test_an_offset_of_the_counts_is_no_feature(digits, design, scale):
    how = {"rails": "single", "epochs": 12, "masks": 12, "hidden": (40, 128), "scale": scale}
    one = quick(digits, design, noise=offset, photons=1e6, **how)
    assert evaluate(one, digits, 1e6, noise=offset, draws=1)[0].accuracy > 0.6


def test_a_seed_repeats(digits):
    assert same(quick(digits, **CAMERA), quick(digits, **CAMERA))
    assert same(quick(digits, noise=photons), quick(digits, noise="shared.noises:photons"))


def test_recipes_have_camera_noise_and_ones_own(digits, tmp_path):
    recipe = small(
        designs="pca", photons=1e4, masks=4,
        camera={
            "noise": ["camera", "shared.noises:saturating"], "sigma": 2.0, "dark": [5e3, 0.0],
        },
        test_noise=["camera", "poisson", "shared.noises:exact"],
    )  # fmt: skip
    trials = plan_trials(recipe, digits)
    assert {trial.job.noise for trial in trials} == {"camera", "shared.noises:saturating"}
    assert [trial.job.camera.dark for trial in trials] == [5e3, 0.0, 0.0]  # dark counts of camera
    assert all(trial.source_hash for trial in trials)
    records = train_trials(trials, digits, tmp_path, device="cpu")
    assert [test["noise"] for test in records[0]["test"]] == list(recipe.test_noise)
    made = Design.load(tmp_path / f"designs/{records[0]['design']}.safetensors")
    [alone] = evaluate(made, digits, 1e4, noise="camera", sigma=2.0, dark=5e3, draws=1)
    assert records[0]["test"][0]["confusion"] == alone.confusion
    plain = plan_trials(small(designs="pca", photons=1e4, masks=4), digits)
    assert not any(trial.source_hash for trial in plain)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"noise": "poisson"}, "noise"),
        ({"camera": {"noise": "camrea"}}, "did you mean 'camera'"),
        ({"camera": {"noise": "poisson", "dark": 5.0}}, "give noise camera"),
        ({"camera": {"noise": "shared:"}}, "unknown noise"),
        ({"test_noise": "camrea"}, "did you mean 'camera'"),
    ],
)
def test_a_recipe_says_what_is_no_noise(changes, match):
    with pytest.raises(ValueError, match=match):
        Recipe(**changes)


def test_camera_noise_on_the_command_line(done, refuse, tmp_path):
    out = tmp_path / "camera.safetensors"
    noise = ("--noise", "camera", "--sigma", "2", "--dark", "100")
    done("design", "--photons", "1e4", "--masks", "5", "--epochs", "1", *noise, "-o", out)
    assert "camera noise" in done("evaluate", out, "--photons", "1e4", *noise)
    done("evaluate", out, "--photons", "1e4", "--noise", "shared.noises:exact")
    dark = ("--noise", "poisson", "--dark", "3")
    assert "give noise camera" in refuse("evaluate", out, "--photons", "1e4", *dark)
