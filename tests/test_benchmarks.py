"""The benchmarks run, and what they compare is what they say."""

from dataclasses import replace

import numpy as np
import psutil
import pytest
import torch
from scipy.stats import binom
from torch import Tensor
from torch.nn import functional

from conftest import generator, quick
from deepfsi import Mlp, load_design
from deepfsi.exposure import JobGroup, TrainingSet, build_training
from deepfsi.hardware.patterns import unpack
from deepfsi.hardware.patterns.frames import recount
from deepfsi.jobs import Job, Training
from deepfsi.physics import ROUNDING_SLACK, light_law
from deepfsi.physics.noise import attach_gradient
from deepfsi.training import train
from shared.benchmarks import benchmark

DRAWS = 400_000
RATES = torch.tensor([[0.7, 1.3], [0.4, 0.0]], dtype=torch.float64)
"""Two readouts; the second has one rail."""


def network() -> Mlp:
    made = Mlp(2, 3, (6, 5), generator=generator(3)).double()
    with torch.no_grad():
        for parameter in made.parameters():
            parameter *= 3  # so that it is far from linear over one count
    return made


def exact_slopes() -> Tensor:
    """∂ E[f] / ∂r by summing over all counts that are at all likely."""
    rates = RATES.clone().requires_grad_()
    each = torch.arange(16, dtype=torch.float64)
    law = (
        torch.exp(-rates[..., None]) * rates[..., None] ** each / torch.exp(torch.lgamma(each + 1))
    )
    joint = torch.einsum("a,b,c,d->abcd", *law.flatten(0, 1))
    counts = torch.cartesian_prod(each, each, each, each)
    with torch.no_grad():
        logits = network()(counts[:, :2] - counts[:, 2:])
        losses = benchmark("gradients").cross_entropy(logits, torch.ones(len(counts)).long())
    assert 1 - joint.sum() < 1e-9
    (joint.flatten() @ losses).backward()
    return rates.grad


def drawn_slopes(name: str) -> tuple[Tensor, Tensor]:
    """Mean of an estimator over many draws, and the standard deviation of that mean."""
    gradients, seeded = benchmark("gradients"), generator(8)
    rates = RATES.expand(DRAWS, 2, 2)
    counts = torch.poisson(rates, generator=seeded)
    scaled = (counts[:, 0] - counts[:, 1]).requires_grad_()
    labels = torch.ones(DRAWS).long()
    losses = gradients.cross_entropy(network()(scaled), labels)
    (slope,) = torch.autograd.grad(losses.sum(), scaled)
    one = torch.ones((), dtype=torch.float64)
    draw = gradients.Draw(
        network(), labels, rates, counts, scaled.detach(), one, losses.detach(), slope
    )
    slopes = gradients.ESTIMATORS[name](draw, seeded)
    return slopes.mean(dim=0), slopes.std(dim=0) / DRAWS**0.5


@pytest.mark.parametrize("name", ["difference", "sampled", "score"])
def test_estimators_that_claim_it_are_unbiased(name):
    mean, error = drawn_slopes(name)
    lit = RATES > 0 if name == "score" else torch.ones_like(RATES, dtype=torch.bool)
    assert ((mean - exact_slopes()).abs() <= 5 * error)[lit].all()


@pytest.mark.parametrize("name", ["straight", "residual", "paired", "midpoint"])
def test_the_others_are_biased(name):
    mean, error = drawn_slopes(name)
    assert ((mean - exact_slopes()).abs() > 10 * error).any()


def test_paired_is_what_the_package_trains_with():
    gradients, net = benchmark("gradients"), network()
    rates = RATES.repeat(50, 1, 1).requires_grad_()
    counts = torch.poisson(rates.detach(), generator=generator(2))
    y = attach_gradient(counts[:, 0] - counts[:, 1], rates[:, 0] - rates[:, 1], rates.sum(dim=1))
    labels = torch.zeros(len(rates)).long()
    losses = functional.cross_entropy(net(0.3 * y), labels, reduction="none")
    wanted, slope = torch.autograd.grad(losses.sum(), [rates, y])
    step = torch.tensor(0.3, dtype=torch.float64)
    draw = gradients.Draw(
        net, labels, rates.detach(), counts, 0.3 * y.detach(), step, losses.detach(), slope / step
    )
    assert torch.allclose(gradients.paired(draw, generator()), wanted, rtol=1e-9, atol=1e-12)


def test_a_step_with_straight_slopes_is_what_autograd_gives():
    """All that `descend` writes out by hand but the slopes themselves: centre, size, classifier."""
    gradients, net = benchmark("gradients"), network()
    rates = (4 * torch.rand(7, 2, 2, generator=generator()).double()).requires_grad_()
    centre = torch.tensor([0.3, -0.2], dtype=torch.float64, requires_grad=True)
    size = torch.tensor(1.7, dtype=torch.float64, requires_grad=True)
    labels = torch.arange(7) % 3
    parts = [rates, centre, size, *net.parameters()]

    gradients.descend(net, rates, centre, size, labels, gradients.straight, generator(5))
    found = [part.grad.clone() for part in parts]
    counts = torch.poisson(rates.detach(), generator=generator(5)) + rates - rates.detach()
    scaled = (counts[:, 0] - counts[:, 1] - centre) / size
    wanted = torch.autograd.grad(functional.cross_entropy(net(scaled), labels), parts)
    for one, other in zip(found, wanted, strict=True):
        assert torch.allclose(one, other, rtol=1e-9, atol=1e-12)


def test_the_comparison_trains_as_the_package(digits):
    scenes = TrainingSet(digits, "cpu")
    settings = Training(epochs=2, precision="float32")
    job = Job(masks=6, photons=300, camera="paper", seed=3, training=settings)
    (theirs,) = train(scenes, [job])
    ours = benchmark("gradients").learn(scenes, job, None)
    assert torch.allclose(ours.rails.stacked, theirs.rails.stacked, rtol=0, atol=1e-4)
    for name in ("mean", "std", "shares"):
        assert torch.allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-3, atol=1e-5)
    for mine, other in zip(
        ours.classifier.parameters(), theirs.classifier.parameters(), strict=True
    ):
        assert torch.allclose(mine, other, rtol=0, atol=1e-3)


def test_masks_to_keep_stay_while_their_classifier_learns(digits):
    gradients, scenes = benchmark("gradients"), TrainingSet(digits, "cpu")
    job = Job(
        masks=6,
        photons=300,
        camera="paper",
        training=Training(epochs=1, precision="float32"),
    )
    first = gradients.learn(scenes, job, None)
    again = gradients.learn(scenes, job, gradients.straight, keep=first.matrix)
    assert torch.allclose(again.rails.stacked, first.rails.stacked, rtol=0, atol=1e-5)
    assert not torch.equal(again.classifier.layers[0].weight, first.classifier.layers[0].weight)


def test_the_comparison_of_gradients_runs(tmp_path, capsys):
    gradients, table = benchmark("gradients"), tmp_path / "trials.csv"
    gradients.main(["--data", "digits", "--quick", "--csv", str(table)])
    printed = capsys.readouterr().out
    for name in (*gradients.ESTIMATORS, *gradients.CONTROLS):
        assert f"| 100 | 6 | {name} |" in printed
    estimators, grid, seeds = len(gradients.ESTIMATORS), 2, 2
    rows = table.read_text().splitlines()
    assert len(rows) == 1 + estimators * (grid + seeds) + len(gradients.CONTROLS) * seeds


def test_frames_are_compared_on_the_same_work(capsys):
    frames = benchmark("dmd")
    on = frames.count_mirrors(frames.signed("grey", 2))
    for ours, plain in zip(frames.our_ordered(on), frames.plain_ordered(on), strict=True):
        assert (ours == plain).all()
    for way in (frames.our_random, frames.plain_random):
        for counts, frame in zip(on, way(on), strict=True):
            mirrors = unpack(frame, frames.DEVICE)
            assert (recount(mirrors, frames.GRID) == counts).all()
    frames.main(["--quick"])
    printed = capsys.readouterr().out
    for row in ("| hadamard | ordered |", "| grey | random |", "| grey |", "| 11 | 1.1 |"):
        assert row in printed


def test_the_comparison_of_photon_counting_runs(capsys):
    """Counts of all ways are compared inside."""
    benchmark("photons").main(["--records", "3e5", "--inputs", "2", "--rounds", "2"])
    printed = capsys.readouterr().out
    for name in ("deepfsi", "ptufile + numpy", "a record at a time"):
        assert f"| {name} |" in printed
    assert "peak memory, deepfsi" in printed


def test_decisions_are_timed(capsys):
    """From the bytes of a run, whose decisions come out again."""
    few = ["--times", "20", "--scenes", "3", "--flux", "1e6", "--block", "1000"]
    benchmark("live").main(["decision", *few])
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    assert len(rows) == 2 + 2 + 2


def test_adaptive_masks_are_tested_and_timed(capsys):
    few = ["--validation", "1100", "--scenes", "200", "--looks", "3"]
    benchmark("adaptive").main(few)
    assert "| 10000 | 3 | 0." in capsys.readouterr().out
    benchmark("adaptive").main([*few, "--latency"])
    assert "one decision: " in capsys.readouterr().out


def test_the_comparison_of_streaming_runs(capsys):
    """Counts of all ways are compared inside."""
    small = ["--records", "2e5", "--frame", "1e-4", "--blocks", "65536", "--rounds", "1"]
    benchmark("live").main(["reader", *small])
    printed = capsys.readouterr().out
    for name in ("stream, 65,536 bytes at once", "whole file", "numpy"):
        assert f"| {name} |" in printed


def test_both_trainings_of_ovit_do_the_same_work(capsys):
    """They start from one set of masks, and see the same patches in the same light."""
    from deepfsi.datasets import from_arrays
    from deepfsi.jobs import Patches, cut_patches

    ovit = benchmark("ovit")
    ovit.main(["--images", "100", "--size", "16", "--rounds", "1", "--epochs", "1"])
    printed = capsys.readouterr().out
    assert "ratio" in printed
    assert printed.count("images/s") == 2

    x = torch.rand(60, 16, 16, generator=generator()).numpy()
    data = from_arrays(x, torch.arange(60).numpy() % 10)
    scenes = TrainingSet(data, "cpu")
    job = Job(
        masks=16,
        photons=ovit.BUDGET,
        camera="paper",
        exposure=Patches(patch=4),
        training={"classifier_arguments": {"width": 8, "depth": 1, "heads": 2, "hidden": 8}},
    )
    plain = ovit.Plain(job, data, scenes.summed_reflectance)
    matrix = plain.masks.detach() * plain.unit
    start = build_training(JobGroup.of(scenes, [job])).masks()
    assert torch.allclose(matrix, start.difference[0], atol=1e-6)
    rows = torch.from_numpy(data.x_train) * (ovit.BUDGET / scenes.summed_reflectance)
    seen = torch.nn.functional.unfold(rows.view(-1, 1, 16, 16), 4, stride=4).transpose(1, 2)
    assert torch.allclose(seen, cut_patches(rows, (16, 16), 4))
    assert plain(torch.from_numpy(data.x_train)).shape == (len(data.x_train), 10)


def test_the_comparison_of_inference_runs(capsys):
    """What both give is compared inside."""
    pytest.importorskip("onnxruntime")
    few = ["--data", "digits", "--masks", "5", "--exposures", "20", "--rounds", "1"]
    benchmark("inference").main(few)
    assert "| 5 | 40 128 |" in capsys.readouterr().out


def test_conditions_are_those_of_the_camera(capsys):
    words = ["--data", "digits", "--scenes", "600", "--epochs", "2", "--masks", "4"]
    found = benchmark("conditions").main(words)
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(found)
    assert all(0 <= value <= 1 for row in found.values() for value in row)


def test_a_design_elsewhere_sees_the_same_features(digits):
    """Under stray light whose mean is subtracted the features keep their mean and scale."""
    conditions = benchmark("conditions")
    from conftest import quick
    from deepfsi.datasets import ambient

    design = quick(digits, light="free-dwell", rails="single")
    there = conditions.under(design, digits, 0.0, 2.0)
    bright = ambient(digits, 2.0)
    here, other = (
        made.scanner("none")(torch.from_numpy(x) / made.summed_reflectance) * 1e3
        for made, x in ((design, digits.x_test), (there, bright.x_test * 1.0))
    )
    own, seen = design.logits(here, 1e3), there.logits(3 * other, 3e3)
    torch.testing.assert_close(own, seen, rtol=1e-3, atol=1e-3)


def test_the_bound_rises_with_the_budget(capsys):
    benchmark("bound").main(
        ["--data", "digits", "--photons", "50", "1e5", "--epochs", "12", "--batch", "50"]
    )
    rows = [line.split("|") for line in capsys.readouterr().out.splitlines()[2:]]
    dim, bright = (float(row[2]) for row in rows)
    assert 0.1 < dim < bright - 0.1
    assert bright > 0.85


def test_light_that_falls_where_it_tells_reads_more(capsys, tmp_path):
    """A dose of structured light against impulse imaging of the same dose, alike everywhere."""
    words = ["--data", "digits", "--epochs", "15", "--batch", "50"]
    benchmark("dose").main([*words, "--dose", "250", "--out", str(tmp_path / "lit.safetensors")])
    lit = float(capsys.readouterr().out.splitlines()[2].split("|")[4])
    rails = load_design(tmp_path / "lit.safetensors").rails.stacked
    assert light_law("dose").excess(rails) == pytest.approx(0, abs=ROUNDING_SLACK)
    assert rails.max() > 1  # more than `column` would give to any pixel
    assert lit > 0.8


@pytest.mark.slow
def test_a_training_is_timed_and_processes_beside_it_can_be_busy(capsys, monkeypatch):
    """One way of the three, each of which takes a process that imports torch."""
    load = benchmark("load")
    monkeypatch.setattr(load, "WAYS", {"one thread": load.WAYS["one thread"]})
    few = ["--data", "digits", "--scenes", "200", "--masks", "3", "--epochs", "1"]
    load.main([*few, "--busy", "0", "--rounds", "1"])
    printed = capsys.readouterr().out
    assert "| 0 | one thread |" in printed
    with load.busy(2):
        assert len(psutil.Process().children()) >= 2


def test_light_for_a_calibration_is_tabled(capsys):
    benchmark("calibration_light").main(["--cells", "8", "--photons", "1e5", "--seeds", "2"])
    rows = [line.split("|") for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[1].strip() for row in rows] == ["raster", "hadamard"]
    for row in rows:
        assert int(row[3]) >= 23
        assert float(row[4]) < 0.2


@pytest.mark.slow
def test_growth_is_measured(capsys):
    benchmark("growth").main(["records", "classes", "--most", "1"])
    printed = capsys.readouterr().out
    assert "| 100 | " in printed
    assert "\n| 2 | 4 | " in printed


def test_the_faults_of_the_table_of_power_are_what_they_are_called(digits):
    """Mean light stays where only frames or pictures are moved; one rail of light is as another."""
    module = benchmark("consistency")
    design = quick(digits, masks=8, light="equal-dwell")
    known = module.faults(digits, design, design)
    sound = known.pop(module.SOUND)
    assert np.array_equal(known["another design's photons"], sound)
    for moved in ("two frames swapped", "all frames one late"):
        assert np.array_equal(np.sort(known[moved].reshape(len(sound), -1)), flat(sound))
        assert not np.array_equal(known[moved], sound)
    assert np.count_nonzero((known["two frames swapped"] != sound).any(axis=0)) == 2
    stray = known["stray light in a quarter of the frames"] - sound
    assert np.count_nonzero(stray.max(axis=0) > 0) == 4
    assert known["half the light"].sum() == pytest.approx(sound.sum() / 2)
    assert known["scenes uniform"].std(axis=0).max() < 1e-9
    both = known["scenes inverted"] + sound
    assert both.std(axis=0).max() < 1e-6
    x = digits.x_test[:2].reshape(-1, 8, 8)
    assert np.array_equal(module.shifted(x)[:, :, 4:], x[:, :, :4])
    assert module.halved(x).sum() == pytest.approx(x.sum() / 4)
    assert module.halved(x)[:, 2:6, 2:6].sum() == pytest.approx(x.sum() / 4)


def flat(rates: np.ndarray) -> np.ndarray:
    return np.sort(rates.reshape(len(rates), -1))


def test_products_of_detectors_are_those_of_masks_that_are_dark_elsewhere(capsys):
    """It compares the two results before it times them."""
    benchmark("detectors").main(["--side", "8", "--repeats", "1"])
    assert len(capsys.readouterr().out.splitlines()) == 6


def test_networks_of_both_types_are_timed_and_compared(capsys, monkeypatch):
    bench = benchmark("networks")
    width = bench.rules.BFLOAT16_WIDTH
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    monkeypatch.setattr(bench, "EPOCHS", 60)
    monkeypatch.setattr(bench, "SEEDS", 1)
    monkeypatch.setattr(bench, "BUDGETS", (1e4,))
    monkeypatch.setattr(bench, "COMPARED", (("free-dwell", 4, "2x2", 2, (16,)),))
    monkeypatch.setattr(bench, "TIMED", bench.COMPARED)
    rows = []
    for words in (["--accuracy"], []):
        bench.main(["--data", "digits", "--rounds", "1", *words])
        rows.append(capsys.readouterr().out.splitlines()[-1].split())
    assert rows[0][:3] == rows[1][:3] == ["4", "2x2", "2"]
    assert min(map(float, rows[0][4:6])) > 0.5, "accuracies, far above chance"
    assert width == bench.rules.BFLOAT16_WIDTH
    monkeypatch.setattr(torch.cpu, "get_capabilities", dict)
    with pytest.raises(SystemExit, match="no AVX512-BF16"):
        bench.main(["--data", "digits"])


@pytest.mark.usefixtures("trained_once")
def test_shares_of_a_step_are_of_its_operations(capfd, monkeypatch, digits):
    """All are shown, as a busy machine decides which are the largest of a small training."""
    step = benchmark("step")
    few = replace(digits, x_train=digits.x_train[:200], y_train=digits.y_train[:200])
    monkeypatch.setattr(step, "load_dataset", lambda _: few)
    monkeypatch.setattr(step, "SHOWN", 1000)
    step.main(["--data", "digits", "--masks", "8", "--precision", "float32"])
    title, *rows = capfd.readouterr().out.splitlines()
    assert title.startswith("digits, 8 masks, float32")
    assert any(row.endswith("aten::mm") for row in rows)


def test_the_correction_for_dead_time_brings_back_what_was_lost(made, digits):
    """At 50 ns and some 10⁷ counts/s, as many scenes are unsure as without dead time."""
    bench = benchmark("dead_time")
    shown = bench.show(made("deepfsi", "free-dwell", "single"), digits, 100)
    labels, none = digits.y_test[:100], bench.DeadTime(seconds=0)
    slow = bench.Detector(dead_time_s=5e-8)
    ideal = bench.classify(shown, bench.Detector(), none, labels)
    before = bench.classify(shown, slow, none, labels)
    after = bench.classify(shown, slow, bench.DeadTime(seconds=5e-8), labels)
    assert before.unsure > 0.5 > 0.1 > max(after.unsure, ideal.unsure)
    assert after.faults == 0


@pytest.mark.slow
def test_tests_of_light_and_counts_alarm_as_seldom_as_they_state_and_find_their_faults():
    """As their rates give but once in 10⁶ runs, and their powers but once in a hundred."""
    script = benchmark("false_alarms")
    for law in script.LAWS:
        alarms, found, tries = script.measured(law, 40)
        assert alarms <= binom.ppf(1 - 1e-6, 40, law.stated), law.name
        assert found >= binom.ppf(0.01, tries, law.power), law.name
