"""Measured readouts on the command line: learned, judged, and new ones classified."""

import json

import numpy as np
import pytest

FEW = ("--epochs", 15, "--hidden", "16")


def lines(seed, each, columns="label,clock,laser,v1,v2,v3"):
    """Table of readouts in volts, classes in turn, with the lines of its recordings."""
    rng = np.random.default_rng(seed)
    names = ["cat", "dog"] * each
    volts = rng.normal(size=(2 * each, 3)) + np.where(np.array(names) == "cat", 0, 8)[:, None]
    keys, rows = columns.split(","), []
    for place, (name, row) in enumerate(zip(names, volts, strict=True)):
        values = {"label": name, "clock": place, "laser": f"{rng.normal():.4f}"}
        values |= {f"v{k}": f"{value:.5f}" for k, value in enumerate(row, 1)}
        rows.append(",".join(str(values[key]) for key in keys))
    return "\n".join([columns, *rows, ""])


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("readouts") / "run.csv"
    path.write_text(lines(0, 550))
    return path


def test_learn_judge_and_classify(done, refuse, table, tmp_path):
    made, figure = tmp_path / "run.safetensors", tmp_path / "run.png"
    names = ("--label", "label", "--order", "clock", "--monitor", "laser")
    out = done("readouts", table, *names, *FEW, "-o", made, "--figure", figure)
    for said in (
        "1100 recordings of 3 readouts, 2 classes, guessing 0.500",
        "laser alone does not tell the class",
        "of recordings that follow each other 0.0%",
        "no difference",
    ):
        assert said in out
    assert figure.read_bytes().startswith(b"\x89PNG")
    told = json.loads(done("readouts", table, *names, *FEW, "-o", made, "--force", "--json"))
    assert [each["split"] for each in told["splits"]] == ["random", "later"]
    assert told["splits"][0]["network"]["mean"] > 0.95
    assert told["order"]["neighbour"]["mean"] == 0

    new, short = tmp_path / "new.csv", tmp_path / "short.csv"
    new.write_text(lines(1, 30, "label,v1,v2,v3"))
    short.write_text(lines(1, 30, "label,v1,v2"))
    classify = ("camera", "classify", made)
    found = json.loads(done(*classify, new, "--json"))
    assert found["score"]["new"]["right"] == found["score"]["new"]["answers"] == 60
    assert "outside of the span" in found["remarks"][0]
    assert "but --exposures" in refuse(*classify, new, "--photons", "1e4")
    assert "of shape (60, 2) do not fit: give 3" in refuse(*classify, short)
    for words in (
        "show FILE -o m.png",
        "export FILE",
        "page FILE -o p.html",
        "dmd export FILE -o p",
    ):
        told = refuse(*words.replace("FILE", str(made)).split())
        assert "those of measured readouts are not known" in told


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("", "give --label"),
        ("--label kind", "has no 'kind', but"),
        ("--label label --split pictures", "split"),
        ("--label label --epochs many", "epochs"),
    ],
)
def test_bad_words_are_refused_before_any_training(refuse, table, tmp_path, words, said):
    assert said in refuse("readouts", table, *words.split(), "-o", tmp_path / "run.safetensors")
