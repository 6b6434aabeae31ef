"""Training repeats, treats replicas as if alone, and refuses what it cannot do."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from conftest import (
    FIXED,
    FLOAT32,
    PHOTONS,
    RECIPE,
    every_optics,
    generator,
    light_on,
    own_matrix,
    quick,
    synthetic,
)
from deepfsi.design.artifact import Design
from deepfsi.design.classifiers import Replicas
from deepfsi.design.evaluation import evaluate
from deepfsi.errors import InputError
from deepfsi.optics import codes, constraints
from deepfsi.progress import Report
from deepfsi.training import loop
from deepfsi.training.job import BFLOAT16_COUNTS, Job, TrainingSettings, product_dtype
from deepfsi.training.learning import learn, train
from deepfsi.training.training_set import TrainingSet

SETTINGS = TrainingSettings(**{**RECIPE, "epochs": 3, "dropout": 0.1})
CPU = torch.device("cpu")


def parameters(design: Design) -> list[torch.Tensor]:
    return [design.rails, design.mean, design.std, *design.classifier.parameters()]


def same(first: Design, second: Design) -> bool:
    return all(map(torch.equal, parameters(first), parameters(second)))


@pytest.mark.parametrize("design", ["deepfsi", "pca", "random", "control"])
@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_the_same_seed_repeats_exactly(digits, design, precision):
    first, again, other = (
        quick(digits, design, seed=seed, dropout=0.1, precision=precision) for seed in (3, 3, 4)
    )
    assert same(first, again)
    assert not same(first, other)


def test_training_leaves_the_global_random_state_alone(digits):
    before = torch.get_rng_state()
    quick(digits, dropout=0.1)
    assert torch.equal(torch.get_rng_state(), before)


def test_the_global_random_state_does_not_matter(digits):
    torch.manual_seed(1)
    first = quick(digits, dropout=0.1)
    torch.manual_seed(2)
    assert same(first, quick(digits, dropout=0.1))


def together_and_alone(
    digits, design: str, light: str, rails: str, noise: str = "ml_gauss"
) -> list[tuple[Design, Design]]:
    scenes = TrainingSet(digits, "cpu")
    same = {"design": design, "light": light, "rails": rails, "noise": noise}
    jobs = [Job(masks=6, photons=photons, training=SETTINGS, **same) for photons in (1e3, 1e4, 1e6)]
    return list(zip(train(scenes, jobs), [train(scenes, [job])[0] for job in jobs], strict=True))


def apart(first: Design, second: Design, pixels: torch.Tensor) -> float:
    """Largest difference over its peak, of masks at some pixels, spread and classifier.

    Not of the centre, which takes up whatever masks do where pixels do not vary.
    """
    pairs = [(first.rails[..., pixels], second.rails[..., pixels]), (first.std, second.std)]
    pairs += zip(first.classifier.parameters(), second.classifier.parameters(), strict=True)
    return max(((a - b).abs().max() / b.abs().max()).item() for a, b in pairs)


@every_optics
@pytest.mark.parametrize(
    ("design", "tight"), [("pca", 1e-5), ("random", 1e-5), ("deepfsi", 1e-3), ("control", 1e-2)]
)
def test_replicas_train_together_as_alone(digits, design, light, rails, tight):
    """Up to float32 rounding, after 42 steps; learned masks where a pixel varies."""
    varies = torch.from_numpy(digits.x_train.std(axis=0) > 0.01)
    for one, alone in together_and_alone(digits, design, light, rails):
        assert apart(one, alone, varies) <= tight
        assert one.info["job"] == alone.info["job"]


@every_optics
def test_replicas_draw_the_same_counts_together_as_alone(digits, light, rails):
    """Masks that learn do not: where rounding moves a rate, all draws after it may differ."""
    for one, alone in together_and_alone(digits, "pca", light, rails, "poisson"):
        assert apart(one, alone, torch.arange(64)) <= 1e-6


@every_optics
def test_learned_masks_are_dark_where_no_scene_varies(digits, made, light, rails):
    """Light from there is noise alone; on two arms one of them gets it in any case."""
    constant = torch.from_numpy((digits.x_train == digits.x_train[0]).all(axis=0))
    rails_there = made("deepfsi", light, rails).rails[..., constant]
    assert constant.any()
    assert (rails_there > 0).all() if light == "two-arm" else not rails_there.any()


def test_scenes_that_are_all_alike_can_still_be_trained_on():
    data = synthetic((3, 3))
    data.x_train[:] = 0.5
    assert quick(data, masks=2, start="truncated-hadamard").masks == 2


def test_rounding_does_not_move_masks_where_pixels_never_vary(digits):
    """On two arms their gradient is all but 0; Adam must not blow its rounding up to steps."""
    for one, alone in together_and_alone(digits, "deepfsi", "two-arm", "dual"):
        assert apart(one, alone, torch.arange(64)) <= 1e-3


@pytest.mark.parametrize("stacked", [False, True])
@pytest.mark.parametrize(
    ("design", "change"),
    [
        ("pca", {}),
        ("random", {}),
        ("deepfsi", {}),
        ("deepfsi", {"noise": "gaussian", "sigma": 3.0}),
        ("deepfsi", {"light": "two-arm"}),
        ("deepfsi", {"rails": "single", "light": "free-dwell"}),
        ("control", {}),
        ("pca", {"training": SETTINGS.model_copy(update={"span": 100.0})}),
    ],
)
def test_seeds_train_together_as_alone(digits, monkeypatch, design, change, stacked):
    """With their weights stacked, as on a GPU, or not; alone they are not."""
    change = {"training": SETTINGS.model_copy(update={"start": "random"}), **change}
    jobs = [
        Job(design=design, masks=6, photons=photons, seed=seed, **change)
        for seed, photons in ((3, 1e3), (3, 1e5), (4, 1e4), (7, 1e3))
    ]
    scenes = TrainingSet(digits, "cpu")
    alone = [train(scenes, [job])[0] for job in jobs]
    monkeypatch.setattr(loop, "Replicas", lambda nets, stacked: Replicas(nets, stacks))
    stacks = stacked
    varies = torch.from_numpy(digits.x_train.std(axis=0) > 0.01)
    tight = 1e-2 if design == "control" else 1e-3
    together = train(scenes, jobs)
    for one, other in zip(together, alone, strict=True):
        assert apart(one, other, varies) <= tight
    assert apart(together[0], together[3], varies) > 0.01


def test_replicas_learn_for_their_own_budget(digits):
    jobs = [Job(masks=6, photons=photons, training=SETTINGS) for photons in (1e2, 1e6)]
    starved, bright = train(TrainingSet(digits, "cpu"), jobs)
    assert not torch.allclose(starved.rails, bright.rails, atol=1e-3)
    assert (starved.std > 2 * bright.std).all()


def test_replicas_under_gaussian_noise_may_differ_in_sigma(digits):
    jobs = [
        Job(design="pca", masks=6, photons=1e3, noise="gaussian", sigma=sigma, training=SETTINGS)
        for sigma in (1.0, 30.0)
    ]
    quiet, loud = train(TrainingSet(digits, "cpu"), jobs)
    assert (loud.std > quiet.std).all()


@pytest.mark.parametrize("change", [{"masks": 7}, {"light": "free-dwell"}])
def test_jobs_that_differ_in_more_cannot_share_a_training(digits, change):
    job = Job(masks=6, photons=1e3, training=SETTINGS)
    with pytest.raises(ValueError, match="may differ in photons, sigma and seed only"):
        train(TrainingSet(digits, "cpu"), [job, job.model_copy(update=change)])


@pytest.mark.parametrize("design", FIXED)
def test_fixed_designs_keep_their_masks(made, digits, design):
    found = made(design, "column", "dual").rails
    if design == "raster":
        assert torch.equal(found[0], torch.eye(64) / 64)
        return
    matrix = torch.from_numpy(codes.sensing_matrix(design, found.shape[1], digits, 0)).float()
    single = codes.DESIGNS[design].single_rail
    wanted = constraints.fit(matrix, "column", "single" if single else "dual")
    assert torch.allclose(found, wanted, atol=1e-8)


@every_optics
def test_learned_masks_change_from_their_start(made, light, rails):
    short, longer = made("deepfsi", light, rails), made("pca", light, rails)
    assert not torch.allclose(short.rails, longer.rails, atol=1e-4)


@every_optics
def test_the_control_group_has_the_masks_learned_under_gaussian_noise(digits, light, rails):
    settings = {"light": light, "rails": rails, "sigma": 2.0}
    control = quick(digits, "control", **settings)
    source = quick(digits, "deepfsi", noise="gaussian", **settings)
    assert torch.allclose(control.rails, source.rails, rtol=1e-6, atol=1e-9)
    assert not same(control, source)


@pytest.mark.parametrize("rails", ["dual", "single"])
@pytest.mark.parametrize("noise", ["ml_gauss", "poisson", "gaussian"])
@pytest.mark.parametrize("design", ["pca", "deepfsi"])
def test_features_are_standardised_over_scenes_and_noise(digits, noise, rails, design):
    one = quick(digits, design, noise=noise, sigma=4.0, rails=rails)
    photons = light_on(one, digits.x_train).repeat(20, 1)
    features = one.scanner(noise, 4.0)(photons, generator())
    scaled = (features / PHOTONS - one.mean) / one.std
    n = len(scaled)
    assert scaled.mean(dim=0).abs().max() <= 5 / math.sqrt(n)
    fourth = scaled.pow(4).mean(dim=0)
    assert ((scaled.var(dim=0) - 1).abs() <= 5 * ((fourth - 1) / n).sqrt()).all()


def test_a_common_scale_is_the_same_for_all_features(digits):
    each, common = (quick(digits, "pca", scale=scale) for scale in ("each", "common"))
    assert len(set(common.std.tolist())) == 1
    assert common.std[0].square() == pytest.approx(float(each.std.square().mean()), rel=1e-5)
    assert torch.equal(each.mean, common.mean)


@pytest.mark.parametrize("scale", ["each", "common"])
@pytest.mark.parametrize("noise", ["ml_gauss", "poisson", "gaussian", "none"])
@pytest.mark.parametrize("design", ["deepfsi", "pca", "control"])
def test_every_noise_and_scale_trains(digits, design, noise, scale):
    one = quick(digits, design, noise=noise, scale=scale, epochs=6)
    assert evaluate(one, digits, 1e7)[0].accuracy > 0.3


@pytest.mark.parametrize("design", FIXED)
def test_every_design_reads_digits_in_bright_light(digits, design):
    one = quick(digits, design, photons=1e8, epochs=8, hidden=(40, 128))
    assert evaluate(one, digits, 1e8)[0].accuracy > 0.6


@pytest.mark.parametrize("start", ["pca", "truncated-hadamard", "random", "lda"])
@every_optics
def test_masks_may_start_from_any_design(digits, start, light, rails):
    assert quick(digits, start=start, light=light, rails=rails).masks == 7


@pytest.mark.parametrize("rails", ["dual", "single"])
@pytest.mark.parametrize("start", ["impulse", "raster", "hadamard"])
def test_masks_may_start_from_a_design_of_all_pixels(digits, start, rails):
    assert quick(digits, masks=64, start=start, rails=rails).masks == 64


@pytest.mark.parametrize("light", ["column", "equal-dwell", "free-dwell", "two-arm"])
def test_impulse_imaging_is_column_whatever_else_is_compared(digits, light):
    one = quick(digits, "impulse", light=light)
    assert one.light == "column"
    assert torch.equal(one.rails[0], torch.eye(64))


@pytest.mark.parametrize("shape", [(12, 10), (10,), (3, 8)])
@pytest.mark.parametrize("design", ["deepfsi", "truncated-hadamard", "hadamard", "s-matrix", "pca"])
def test_scenes_may_have_any_shape(shape, design):
    data = synthetic(shape)
    one = quick(data, design, photons=1e7, epochs=30, batch=16)
    assert one.image_shape == shape
    assert evaluate(one, data, 1e7)[0].accuracy > 0.5


def test_a_batch_may_be_larger_than_the_data():
    assert quick(synthetic((4, 4), scenes=30), batch=500).masks == 7


@pytest.mark.parametrize("design", ["deepfsi", "pca", "control"])
def test_progress_rises_to_one(digits, design):
    seen = []
    quick(digits, design, epochs=3, report=Report(lambda share, what: seen.append(share)))
    assert seen == sorted(seen)
    assert 0 == seen[0] < seen[-1] == 1
    assert len(set(seen)) > 2


@pytest.mark.parametrize(
    "settings",
    [
        *({"photons": bad} for bad in (0, -1, math.nan, math.inf, "abc", None)),
        *({"masks": bad} for bad in (0, -1, 65, 10.5, math.nan, "ten")),
        {"design": "deepfsy"},
        {"light": "colum"},
        {"rails": "triple"},
        {"light": "two-arm", "rails": "single"},
        {"design": "hadamard", "masks": 64, "rails": "single"},
        {"design": "raster", "masks": 64, "light": "two-arm"},
        {"design": "lda", "masks": 10},
        {"noise": "poison"},
        *({"sigma": bad} for bad in (0, -1, math.nan, math.inf)),
        {"epochs": 0},
        {"batch": 1},
        *({"lr": bad} for bad in (0, -1, math.nan, math.inf)),
        *({"mask_lr": bad} for bad in (0, -1, math.nan, math.inf)),
        {"decay": math.inf},
        *({"dropout": bad} for bad in (-0.1, 1.0, math.nan)),
        *({"hidden": bad} for bad in ((0,), (-3,), (8, 0), (1.5,))),
        {"scale": "none"},
        *({"start": bad} for bad in ("pcaa", "deepfsi", "control", "custom", "hadamard")),
        {"precision": "float16"},
        *({"levels": bad} for bad in (1, -1, 2.5, 2**25)),
        {"seed": 1.5},
        {"seed": 2**70},
        {"design": "random", "seed": -1},
        {"device": "tpu"},
        {"colour": "red"},
    ],
    ids=str,
)
def test_a_setting_that_is_not_allowed_is_one_clear_line(digits, settings):
    with pytest.raises(InputError) as error:
        learn(digits, **{"photons": 1e4, "masks": 7, "epochs": 1, "device": "cpu", **settings})
    assert "\n" not in str(error.value)


@pytest.mark.skipif(torch.cuda.is_available(), reason="has a GPU")
def test_a_missing_gpu_is_said(digits):
    with pytest.raises(InputError, match="cuda is not here"):
        TrainingSet(digits, "cuda")


@every_optics
def test_a_matrix_of_your_own_is_used_as_it_is(digits, light, rails):
    matrix = own_matrix(5, 64, light, rails)
    one = quick(digits, "custom", 5, light=light, rails=rails)
    assert one.matrix == pytest.approx(matrix, abs=1e-7)


@every_optics
def test_a_designs_matrix_can_be_given_back_as_your_own(digits, made, light, rails):
    matrix = made("deepfsi", light, rails).matrix
    settings = {"photons": 1e4, "masks": len(matrix), "epochs": 1, "device": "cpu"}
    again = learn(digits, design="custom", matrix=matrix, light=light, rails=rails, **settings)
    assert again.matrix == pytest.approx(matrix, abs=1e-6)


@pytest.mark.parametrize(
    ("matrix", "match"),
    [
        (np.ones((7, 63)), "shape"),
        (np.ones((6, 64)), "shape"),
        (np.ones(64), "shape"),
        (np.full((7, 64), np.nan), "finite"),
        (np.full((7, 64), "a"), "finite"),
        (np.zeros((7, 64)), "zero everywhere"),
        (np.full((7, 64), 0.2), "breaks the column constraint"),
        (None, "a matrix goes with"),
    ],
)
def test_a_bad_matrix_is_refused_before_training(digits, matrix, match):
    seen = []
    settings = {
        "photons": 1e4,
        "masks": 7,
        "device": "cpu",
        "report": Report(lambda share, what: seen.append(share)),
    }
    with pytest.raises(InputError, match=match):
        learn(digits, design="custom", matrix=matrix, **settings)
    assert not seen


def test_a_negative_matrix_cannot_be_a_single_rail(digits):
    with pytest.raises(InputError, match="negative entries"):
        learn(
            digits,
            design="custom",
            matrix=np.full((2, 64), -0.1),
            photons=1,
            masks=2,
            rails="single",
        )


def test_a_matrix_goes_only_with_the_custom_design(digits):
    with pytest.raises(InputError, match="a matrix goes with"):
        learn(digits, design="pca", matrix=np.full((7, 64), 0.1), photons=1e4, masks=7)


@pytest.fixture
def fast_processor(monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})


@pytest.mark.parametrize(
    ("limit", "settings"),
    [
        (20 * BFLOAT16_COUNTS, {}),
        (20 * BFLOAT16_COUNTS, {"noise": "poisson"}),
        (10 * BFLOAT16_COUNTS, {"rails": "single"}),
        (20 * 128, {"noise": "gaussian"}),
        (20 * 128 * 5, {"noise": "gaussian", "sigma": 5.0}),
    ],
)
def test_bfloat16_only_where_rounding_stays_under_the_noise(fast_processor, limit, settings):
    assert product_dtype(Job(masks=10, photons=limit, **settings), CPU) == torch.bfloat16
    assert product_dtype(Job(masks=10, photons=limit * 1.01, **settings), CPU) == torch.float32


def test_no_noise_or_no_fast_processor_means_float32(fast_processor, monkeypatch):
    assert product_dtype(Job(masks=10, photons=1e2, noise="none"), CPU) == torch.float32
    monkeypatch.setattr(torch.cpu, "get_capabilities", dict)
    assert product_dtype(Job(masks=10, photons=1e2), CPU) == torch.float32


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_a_precision_asked_for_is_used(precision):
    settings = TrainingSettings(precision=precision)
    assert product_dtype(Job(masks=2, photons=1e8, training=settings), CPU) == getattr(
        torch, precision
    )


def rounding(digits, masks: int, photons: float) -> float:
    """RMS error of bfloat16 products over photon noise, for the worst mask."""
    matrix = torch.from_numpy(codes.sensing_matrix("pca", masks, digits)).float()
    difference, total = constraints.combine(constraints.fit(matrix, "column"))
    x = torch.from_numpy(digits.x_train)
    light = photons * x.double() / x.double().sum(dim=1).mean()
    exact, noise = light @ difference.double().T, (light @ total.double().T).sqrt()
    half = (x.bfloat16() @ difference.bfloat16().T).double() * photons / x.double().sum(1).mean()
    return float(((half - exact) / noise).square().mean(dim=0).sqrt().max())


def test_bfloat16_error_is_under_the_photon_noise_where_allowed(digits):
    assert rounding(digits, 10, 20 * BFLOAT16_COUNTS) < 0.5
    assert rounding(digits, 2, 1e8) > 1  # and would not be here


def test_training_in_bfloat16_reads_as_well(digits):
    accuracy = [
        evaluate(quick(digits, masks=10, epochs=8, precision=precision), digits, PHOTONS)[
            0
        ].accuracy
        for precision in ("float32", "bfloat16")
    ]
    assert accuracy[0] == pytest.approx(accuracy[1], abs=0.05)


def test_learned_masks_beat_their_start_in_dim_light(digits):
    accuracy = [
        evaluate(quick(digits, design, 6, photons=1e3, epochs=15), digits, 1e3)[0].accuracy
        for design in ("deepfsi", "pca")
    ]
    assert accuracy[0] > accuracy[1]


def test_small_steps_take_one_thread_and_give_the_others_back(digits, monkeypatch):
    seen = []
    monkeypatch.setattr(torch, "set_num_threads", seen.append)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 7)
    quick(digits, masks=4, batch=32, hidden=(40, 128))
    quick(digits, masks=4, batch=1000, hidden=(40, 128))
    assert seen == [1, 7, 7, 7]


def two_valued(design: Design) -> bool:
    """Whether every entry is 0 or its frame's peak, exactly."""
    rails = design.rails
    return bool(((rails == 0) | (rails == rails.amax(dim=-1, keepdim=True))).all())


@every_optics
@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
@pytest.mark.parametrize("noise", ["ml_gauss", "poisson", "gaussian", "none"])
def test_a_two_level_design_shows_dark_and_peak_alone(digits, light, rails, noise, precision):
    settings = {"light": light, "rails": rails, "noise": noise, "precision": precision}
    one = quick(digits, levels=2, **settings)
    assert two_valued(one)
    assert torch.allclose(one.quantised(2).rails, one.rails, rtol=FLOAT32, atol=0)
    assert not two_valued(quick(digits, **settings))
    constraints.check(one.rails, light)


@pytest.mark.parametrize("design", ["control", "pca", "random", "s-matrix", "raster", "custom"])
def test_levels_hold_for_masks_that_are_not_learned_here(digits, design):
    assert two_valued(quick(digits, design, light="equal-dwell", levels=2))


@every_optics
@pytest.mark.parametrize("levels", [3, 17])
def test_a_design_has_no_more_levels_than_its_device(digits, light, rails, levels):
    rails = quick(digits, light=light, rails=rails, levels=levels).rails.double()
    peak = (rails.sum(dim=0) if light == "two-arm" else rails).amax(dim=-1, keepdim=True)
    level = (levels - 1) * rails / torch.where(peak > 0, peak, 1.0)
    assert level.numpy() == pytest.approx(level.round().numpy(), abs=1e-4)
    assert 2 < len(level.round().unique()) <= levels


@pytest.mark.parametrize("noise", ["ml_gauss", "gaussian"])
@every_optics
def test_statistics_of_a_two_level_design_are_of_its_own_masks(digits, noise, light, rails):
    """Scaled features of its scanner have mean 0 and variance 1."""
    one = quick(digits, noise=noise, sigma=4.0, light=light, rails=rails, levels=2)
    photons = light_on(one, digits.x_train).repeat(20, 1)
    features = one.scanner(noise, 4.0)(photons, generator())
    scaled = (features / PHOTONS - one.mean) / one.std
    n = len(scaled)
    assert scaled.mean(dim=0).abs().max() <= 5 / math.sqrt(n)
    fourth = scaled.pow(4).mean(dim=0)
    assert ((scaled.var(dim=0) - 1).abs() <= 5 * ((fourth - 1) / n).sqrt()).all()


@pytest.mark.parametrize(("light", "rails"), [("column", "dual"), ("free-dwell", "single")])
def test_two_level_designs_train_together_as_alone(digits, light, rails):
    """But for cells so near half their frame's peak that float32 rounding decides them."""
    jobs = [
        Job(
            masks=6,
            photons=photons,
            seed=seed,
            light=light,
            rails=rails,
            training=SETTINGS.model_copy(update={"levels": 2, "mask_lr": 0.1}),
        )
        for seed, photons in ((3, 1e3), (3, 1e5), (4, 1e4))
    ]
    scenes = TrainingSet(digits, "cpu")
    together = train(scenes, jobs)
    for one, job in zip(together, jobs, strict=True):
        assert two_valued(one)
        lit, alone = one.rails > 0, train(scenes, [job])[0].rails > 0
        assert (lit != alone).double().mean() <= 0.01
    assert ((together[0].rails > 0) != (together[1].rails > 0)).any()


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("light", "rails"),
    [("equal-dwell", "single"), ("free-dwell", "single"), ("two-arm", "dual"), ("column", "dual")],
)
def test_learning_two_levels_beats_rounding_to_them(digits, light, rails, seed):
    """By more than five sigma of the noise draws, in which alone the two tests differ."""
    draws = 20
    settings = {"light": light, "rails": rails, "seed": seed, "hidden": (40, 128), "lr": 1e-2}
    learned, continuous = (
        quick(digits, masks=10, epochs=30, mask_lr=1e-1, scale="common", levels=levels, **settings)
        for levels in (2, 0)
    )
    trained, rounded = (
        evaluate(design, digits, PHOTONS, draws=draws)[0].accuracy
        for design in (learned, continuous.quantised(2))
    )
    trials = draws * len(digits.x_test)
    spread = (trained * (1 - trained) + rounded * (1 - rounded)) / trials
    assert trained - rounded > 5 * spread**0.5


def test_levels_survive_the_design_file(digits, tmp_path):
    one = quick(digits, light="free-dwell", levels=2)
    again = Design.load(one.save(tmp_path / "one.safetensors"))
    assert torch.equal(again.rails, one.rails)
    assert again.info["job"]["training"]["levels"] == 2
