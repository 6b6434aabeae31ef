"""The benchmarks run, and what they compare is what they say."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.stats import binom
from torch.nn import functional

from conftest import generator, quick
from deepfsi import Mlp, load_design
from deepfsi.datasets.arrays import from_arrays
from deepfsi.exposure.training import JobGroup
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.job import Job
from deepfsi.jobs.training import Training
from deepfsi.physics.laws import ROUNDING_SLACK, light_law
from deepfsi.physics.noise import attach_gradient
from deepfsi.training.learning import train
from deepfsi_paper.patches.settings import Patches, cut_patches
from shared.benchmarks import benchmark

DRAWS = 400_000
RUNS = 40
"""Without a fault, of each test of light and counts; 15 do not show one that alarms too often."""

RATES = torch.tensor([[0.7, 1.3], [0.4, 0.0]], dtype=torch.float64)
"""Two readouts; the second has one rail."""


@pytest.fixture
def printed(capsys):
    """Give a function that runs a benchmark and gives the lines that it printed."""

    def run(name, words):
        benchmark(name).main(words.split())
        return capsys.readouterr().out.splitlines()

    return run


def cells(line):
    return [cell.strip() for cell in line.split("|")]


def network():
    made = Mlp(2, 3, (6, 5), generator=generator(3)).double()
    with torch.no_grad():
        for parameter in made.parameters():
            parameter *= 3  # so that it is far from linear over one count
    return made


def exact_slopes():
    """∂ E[f] / ∂r by summing over all counts that are at all likely."""
    rates = RATES.clone().requires_grad_()
    count = torch.arange(16, dtype=torch.float64)
    r = rates[..., None]
    law = torch.exp(-r) * r**count / torch.exp(torch.lgamma(count + 1))
    joint = torch.einsum("a,b,c,d->abcd", *law.flatten(0, 1))
    counts = torch.cartesian_prod(count, count, count, count)
    with torch.no_grad():
        logits = network()(counts[:, :2] - counts[:, 2:])
        losses = benchmark("gradients").cross_entropy(logits, torch.ones(len(counts)).long())
    assert 1 - joint.sum() < 1e-9
    (joint.flatten() @ losses).backward()
    return rates.grad


@pytest.mark.parametrize(
    ("name", "unbiased"),
    [(name, True) for name in ("difference", "sampled", "score")]
    + [(name, False) for name in ("straight", "residual", "paired", "midpoint")],
)
def test_estimators_that_claim_it_are_unbiased_and_no_others(name, unbiased):
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
    off = (slopes.mean(dim=0) - exact_slopes()).abs() / (slopes.std(dim=0) / DRAWS**0.5)
    lit = RATES > 0 if name == "score" else torch.ones_like(RATES, dtype=torch.bool)
    assert (off[lit] <= 5).all() if unbiased else (off > 10).any()


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
    slopes = [part.grad.clone() for part in parts]
    counts = torch.poisson(rates.detach(), generator=generator(5)) + rates - rates.detach()
    scaled = (counts[:, 0] - counts[:, 1] - centre) / size
    wanted = torch.autograd.grad(functional.cross_entropy(net(scaled), labels), parts)
    for one, other in zip(slopes, wanted, strict=True):
        assert torch.allclose(one, other, rtol=1e-9, atol=1e-12)


def test_the_comparison_trains_as_the_package_and_keeps_masks(digits):
    gradients, scenes = benchmark("gradients"), TrainingSet(digits, "cpu")
    settings = Training(epochs=2, precision="float32")
    job = Job(masks=6, photons=300, camera="paper", seed=3, training=settings)
    [theirs] = train(scenes, [job])
    ours = gradients.learn(scenes, job, None)
    assert torch.allclose(ours.rails.stacked, theirs.rails.stacked, rtol=0, atol=1e-4)
    for name in ("mean", "std", "shares"):
        mine, other = (getattr(made.exposure, name) for made in (ours, theirs))
        assert torch.allclose(mine, other, rtol=1e-3, atol=1e-5)
    pairs = zip(ours.classifier.parameters(), theirs.classifier.parameters(), strict=True)
    assert all(torch.allclose(mine, other, rtol=0, atol=1e-3) for mine, other in pairs)
    again = gradients.learn(scenes, job, gradients.straight, keep=ours.matrix)
    assert torch.allclose(again.rails.stacked, ours.rails.stacked, rtol=0, atol=1e-5)
    assert not torch.equal(again.classifier.layers[0].weight, ours.classifier.layers[0].weight)


def test_the_comparison_of_gradients_runs(tmp_path, printed):
    gradients, table = benchmark("gradients"), tmp_path / "trials.csv"
    lines = "\n".join(printed("gradients", f"--data digits --quick --csv {table}"))
    for name in (*gradients.ESTIMATORS, *gradients.CONTROLS):
        assert f"| 100 | 6 | {name} |" in lines
    estimators, grid, seeds = len(gradients.ESTIMATORS), 2, 2
    rows = estimators * (grid + seeds) + len(gradients.CONTROLS) * seeds
    assert len(table.read_text().splitlines()) == 1 + rows


READER = "--records 2e5 --frame 1e-4 --blocks 65536 --rounds 1"
ADAPTIVE = "--validation 1100 --scenes 200 --looks 3"


@pytest.mark.parametrize(
    ("name", "words", "rows"),
    [
        ("photons", "--records 3e5 --inputs 2 --rounds 2", ["| deepfsi |", "| ptufile + numpy |"]),
        ("live", f"reader {READER}", ["| stream, 65,536 bytes at once |", "| whole file |"]),
        ("adaptive", ADAPTIVE, ["| 10000 | 3 | 0."]),
        ("adaptive", f"{ADAPTIVE} --latency", ["one decision: "]),
        ("clicks", "--counts 2 --looks 6 --images 300", ["price ", "| 200 | ", "| 300 | "]),
        ("inference", "--data digits --masks 5 --exposures 20 --rounds 1", ["| 5 | 40 128 |"]),
        ("calibration_light", "--cells 8 --photons 1e5 --seeds 2", ["| raster |", "| hadamard |"]),
        (
            "conditions",
            "--data digits --scenes 600 --epochs 2 --masks 4",
            ["trained with "],
        ),
    ],
)
def test_a_comparison_runs(printed, name, words, rows):
    """What its ways give is compared inside."""
    lines = printed(name, words)
    for row in rows:
        assert sum(row in line for line in lines) >= rows.count(row), row


def test_both_trainings_of_ovit_do_the_same_work(printed):
    """They start from one set of masks, and see the same patches in the same light."""
    ovit = benchmark("ovit")
    lines = printed("ovit", "--images 100 --size 16 --rounds 1 --epochs 1")
    assert sum("images/s" in line for line in lines) == 2

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
    start = JobGroup(scenes, [job]).training().masks()
    assert torch.allclose(plain.masks.detach() * plain.unit, start.difference[0], atol=1e-6)
    rows = torch.from_numpy(data.x_train) * (ovit.BUDGET / scenes.summed_reflectance)
    cut = torch.nn.functional.unfold(rows.view(-1, 1, 16, 16), 4, stride=4).transpose(1, 2)
    assert torch.allclose(cut, cut_patches(rows, (16, 16), 4))
    assert plain(torch.from_numpy(data.x_train)).shape == (len(data.x_train), 10)


def test_a_design_elsewhere_sees_the_same_features(digits):
    """Under stray light whose mean is subtracted the features keep their mean and scale."""
    design = quick(digits, light="free-dwell", rails="single")
    there = benchmark("conditions").under(design, digits, 0.0, 2.0)
    here, other = (
        made.scanner("none")(torch.from_numpy(x) / made.summed_reflectance) * 1e3
        for made, x in (
            (design, digits.x_test),
            (there, benchmark("conditions").ambient(digits, 2.0).x_test * 1.0),
        )
    )
    torch.testing.assert_close(
        *(made.answer(each / 1e3, 1e3).logits for made, each in ((design, here), (there, other))),
        rtol=1e-3,
        atol=1e-3,
    )


def test_the_bound_rises_with_the_budget(printed):
    words = "--data digits --photons 50 1e5 --epochs 12 --batch 50"
    dim, bright = (float(cells(row)[2]) for row in printed("bound", words)[2:])
    assert 0.1 < dim < bright - 0.1
    assert bright > 0.85


def test_light_that_falls_where_it_tells_reads_more(printed, tmp_path):
    """A dose of structured light against impulse imaging of the same dose, alike everywhere."""
    file = tmp_path / "lit.safetensors"
    rows = printed("dose", f"--data digits --epochs 15 --batch 50 --dose 250 --out {file}")
    rails = load_design(file).rails.stacked
    assert light_law("dose").excess(rails) == pytest.approx(0, abs=ROUNDING_SLACK)
    assert rails.max() > 1  # more than `column` would give to any pixel
    assert float(cells(rows[2])[4]) > 0.8


def test_the_faults_of_the_table_of_power_are_what_they_are_called(digits):
    """Mean light stays where only frames or pictures are moved; one rail of light is as another."""
    module = benchmark("consistency")
    design = quick(digits, masks=8, light="equal-dwell")
    rates = module.faults(digits, design, design)
    sound = rates.pop(module.SOUND)
    assert np.array_equal(rates["another design's photons"], sound)
    for moved in ("two frames swapped", "all frames one late"):
        one, other = (np.sort(each.reshape(len(sound), -1)) for each in (rates[moved], sound))
        assert np.array_equal(one, other)
        assert not np.array_equal(rates[moved], sound)
    assert np.count_nonzero((rates["two frames swapped"] != sound).any(axis=0)) == 2
    stray = rates["stray light in a quarter of the frames"] - sound
    assert np.count_nonzero(stray.max(axis=0) > 0) == 4
    assert rates["half the light"].sum() == pytest.approx(sound.sum() / 2)
    assert rates["scenes uniform"].std(axis=0).max() < 1e-9
    assert (rates["scenes inverted"] + sound).std(axis=0).max() < 1e-6
    x = digits.x_test[:2].reshape(-1, 8, 8)
    assert np.array_equal(module.shifted(x)[:, :, 4:], x[:, :, :4])
    for halved in (module.halved(x), module.halved(x)[:, 2:6, 2:6]):
        assert halved.sum() == pytest.approx(x.sum() / 4)


def test_networks_of_both_types_are_timed_and_compared(printed, monkeypatch):
    bench = benchmark("networks")
    width, job = bench.rules.BFLOAT16_WIDTH, ("free-dwell", 4, "2x2", (16,))
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"avx512_bf16": True})
    small = {"EPOCHS": 30, "SEEDS": 1, "BUDGETS": (1e4,), "COMPARED": (job,), "TIMED": (job,)}
    for name, value in small.items():
        monkeypatch.setattr(bench, name, value)
    accurate, timed = (
        printed("networks", f"--data digits --rounds 1 {words}")[-1].split()
        for words in ("--accuracy", "")
    )
    assert accurate[:2] == timed[:2] == ["4", "2x2"]
    assert min(map(float, accurate[3:5])) > 0.5, "accuracies, far above chance"
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
    ideal, before, after = (
        bench.classify(shown, detector, bench.DeadTime(seconds=known), digits.y_test[:100])
        for detector, known in (
            (bench.Detector(), 0),
            (bench.Detector(dead_time_s=5e-8), 0),
            (bench.Detector(dead_time_s=5e-8), 5e-8),
        )
    )
    assert before.unsure > 0.5 > 0.1 > max(after.unsure, ideal.unsure)
    assert after.faults == 0


@pytest.mark.slow
def test_tests_of_light_and_counts_alarm_as_seldom_as_they_state_and_find_their_faults():
    """As their rates give but once in 10⁶ runs, and their powers but once in a hundred."""
    script = benchmark("false_alarms")
    for law in script.LAWS:
        alarms, powers, tries = script.measured(law, RUNS)
        assert alarms <= binom.ppf(1 - 1e-6, RUNS, law.stated), law.name
        assert powers >= binom.ppf(0.01, tries, law.power), law.name


def test_fixed_masks_for_few_clicks_are_tabled_with_no_more_clicks(printed, tmp_path):
    """15 %: test images of digits are brighter by up to 3 %, and the training has few steps."""
    words = "--data digits --clicks 3 --seeds 0 --masks 12 --photons 300 --epochs 10"
    *_, dwell, column = [cells(line) for line in printed("few_clicks", f"{words} -o {tmp_path}")]
    for row, law in ((dwell, "free-dwell"), (column, "column")):
        assert row[1:6] == ["3", law, "300", "12", "0"]
        accuracy, interval = map(float, row[7].split(" ± "))
        assert 0.2 < accuracy < 0.6
        assert 0.01 < interval < 0.06
        assert float(row[9]) == pytest.approx(0.98 * 3, rel=0.15)
        assert float(row[10]) > float(row[9])
        made = load_design(tmp_path / f"{law}-3-0.safetensors")
        assert made.matrix.shape == (12, 64)
    short = f"{words} --laws column --validation".replace("--epochs 10", "--epochs 1")
    *_, read = printed("few_clicks", short)
    assert len(cells(read)) == len(dwell) - 2
