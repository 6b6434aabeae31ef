"""The benchmarks run, and what they compare is what they say."""

import numpy as np
import pytest
import torch

from deepfsi import load_design
from deepfsi.physics.laws import ROUNDING_SLACK, light_law
from shared.benchmarks import benchmark


@pytest.fixture
def printed(capsys):
    """Give a function that runs a benchmark and gives the lines that it printed."""

    def run(name, words):
        benchmark(name).main(words.split())
        return capsys.readouterr().out.splitlines()

    return run


def cells(line):
    return [cell.strip() for cell in line.split("|")]


READER = "--records 2e5 --frame 1e-4 --blocks 65536 --rounds 1"
ADAPTIVE = "--validation 1100 --scenes 200 --looks 3"


@pytest.mark.parametrize(
    ("name", "words", "rows"),
    [
        ("photons", "--records 3e5 --inputs 2 --rounds 2", ["| deepfsi |", "| ptufile + numpy |"]),
        ("live", f"reader {READER}", ["| stream, 65,536 bytes at once |", "| whole file |"]),
        ("adaptive", ADAPTIVE, ["| 10000 | 3 | 0."]),
        ("adaptive", f"{ADAPTIVE} --latency", ["one decision: "]),
        ("clicks", "--counts 2 --looks 3 --images 210 --scenes 1000", ["| 200 | ", "| 210 | "]),
        ("inference", "--data digits --masks 5 --exposures 20 --rounds 1", ["| 5 | 40 128 |"]),
        ("calibration_light", "--cells 8 --photons 1e5 --seeds 2", ["| raster |", "| hadamard |"]),
    ],
)
def test_a_comparison_runs(printed, name, words, rows):
    """What its ways give is compared inside."""
    lines = printed(name, words)
    for row in rows:
        assert sum(row in line for line in lines) >= rows.count(row), row


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


def test_the_faults_of_the_table_of_marks_are_what_they_are_called(digits):
    bench, rng = benchmark("unlike"), np.random.default_rng(0)
    x = digits.x_test[:6].reshape(-1, 8, 8).astype(float)
    assert np.allclose(bench.moved(x, rng), x)
    quarter = bench.moved(x, rng, turn=90)
    assert any(np.allclose(quarter, np.rot90(x, k, (1, 2)), atol=0.05) for k in (1, 3))
    half = bench.moved(x, rng, scale=0.5)
    assert np.allclose(half[:, :4, :4], x.reshape(-1, 4, 2, 4, 2).mean(axis=(2, 4)))
    assert half[:, 4:].max() == half[:, :, 4:].max() == 0
    cases = bench.CASES
    assert cases["5 % of the mirrors OFF"].lit(rng).sum() == 61
    assert set(cases["a column of mirrors OFF"].lit(rng).sum(axis=0)) == {0, 8}
    assert np.array_equal(cases["display lags by a scene"].shown(x, rng)[1:], x[:-1])
    for name in ("noise", "stars", "squares", "circles"):
        shown = cases[name].shown(x, rng)
        assert shown.shape == x.shape
        assert 0.3 <= shown.min() < 0.6 < shown.max() <= 1
    assert bench.objects(x, rng, edges=4).std() > 0.1


@pytest.mark.slow
def test_the_table_of_marks_has_a_row_for_each_fault(printed, tmp_path, monkeypatch):
    """A lag is marked by a scene that is to be dark, and by nothing without one."""
    for title, settings in benchmark("unlike").DESIGNS.items():
        if title.startswith("recorded"):
            monkeypatch.setitem(settings, "training", {"epochs": 2, "batch": 100})
    words = f"--runs 1 --sound 1 --scenes 6 --masks 3 --folder {tmp_path} --only"
    lines = printed("unlike", f"{words} scene")
    lag, told = (cells(line)[2:6] for line in lines[2:4])
    assert [each[-6:] for each in told] == 4 * ["(1.00)"]
    assert "(1.00)" not in lag
    assert "[0.000, 0.975]" in printed("unlike", f"{words} nothing")[-1]


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


def test_the_correction_for_dead_time_brings_back_what_was_lost(made, digits):
    """At 50 ns and some 10⁷ counts/s, as many scenes are unlike as without dead time."""
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
    assert before.unlike > 0.5 > 0.1 > max(after.unlike, ideal.unlike)
    assert after.faults == 0
