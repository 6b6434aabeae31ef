"""Measured readouts on the command line: learned, judged, and new ones classified."""

import json

import numpy as np
import pytest

FEW = ("--epochs", 15, "--hidden", "16", "--dropout", "0")
CLASSES, EACH = 2, 550


def lines(seed, each):
    """Table of readouts in volts, classes in turn, with the lines of its recordings."""
    rng = np.random.default_rng(seed)
    names = ["cat", "dog"] * each
    volts = rng.normal(size=(2 * each, 3)) + np.where(np.array(names) == "cat", 0, 8)[:, None]
    rows = [
        f"{name},{place},{rng.normal():.4f},{','.join(f'{value:.5f}' for value in row)}"
        for place, (name, row) in enumerate(zip(names, volts, strict=True))
    ]
    return "\n".join(["label,clock,laser,v1,v2,v3", *rows, ""])


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("readouts") / "run.csv"
    path.write_text(lines(0, EACH))
    return path


def test_learn_judge_and_classify(done, refuse, table, tmp_path):
    made, figure = tmp_path / "run.safetensors", tmp_path / "run.png"
    names = ("--label", "label", "--order", "clock", "--monitor", "laser")
    out = done("readouts", table, *names, *FEW, "-o", made, "--figure", figure)
    assert "1100 recordings of 3 readouts, 2 classes, guessing 0.500" in out
    assert "laser alone does not tell the class" in out
    assert "of recordings that follow each other 0.0%" in out
    assert "no difference" in out
    assert figure.read_bytes().startswith(b"\x89PNG")

    new = tmp_path / "new.csv"
    rows = lines(1, 30).splitlines()
    new.write_text("\n".join(",".join((row.split(",")[0], *row.split(",")[3:])) for row in rows))
    found = json.loads(done("camera", "classify", made, new, "--json"))
    assert found["score"]["new"]["right"] == found["score"]["new"]["answers"] == 60
    assert "outside of the span" in found["remarks"][0]
    told = json.loads(done("readouts", table, *names, *FEW, "-o", made, "--force", "--json"))
    assert [each["split"] for each in told["splits"]] == ["random", "later"]
    assert told["splits"][0]["network"]["mean"] > 0.95
    assert told["order"]["neighbour"]["mean"] == 0

    masks = "those of measured readouts are not known"
    assert masks in refuse("show", made, "-o", tmp_path / "masks.png")
    assert masks in refuse("export", made)
    assert masks in refuse("page", made, "-o", tmp_path / "p.html")
    assert masks in refuse("dmd", "export", made, "--device", "dlp7000", "-o", tmp_path / "frames")
    assert "but --exposures" in refuse("camera", "classify", made, new, "--photons", "1e4")
    assert "of shape (60, 2) do not fit: give 3" in refuse("camera", "classify", made, _cut(new))


def _cut(path):
    short = path.with_name("short.csv")
    rows = [row.rsplit(",", 1)[0] for row in path.read_text().splitlines()]
    short.write_text("\n".join(rows))
    return short


def test_bad_words_are_refused_before_any_training(refuse, table, tmp_path):
    out = ("-o", tmp_path / "run.safetensors")
    assert "give --label" in refuse("readouts", table, *out)
    assert "has no 'kind', but" in refuse("readouts", table, "--label", "kind", *out)
    assert "split" in refuse("readouts", table, "--label", "label", "--split", "pictures", *out)
    assert "no table of readouts" in refuse("readouts", tmp_path / "none", *out)
    assert "epochs" in refuse("readouts", table, "--label", "label", "--epochs", "many", *out)
