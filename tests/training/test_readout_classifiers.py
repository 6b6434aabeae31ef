"""Classifiers of measured readouts: any unit, and the traps of a recording named."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deepfsi.datasets.readouts import MeasuredReadouts, Variables, read_readouts
from deepfsi.design.readouts import classify_readouts
from deepfsi.training.readouts import learn_readouts, measure_order, measure_readouts

pytestmark = pytest.mark.usefixtures("trained_once")

FEW = {"epochs": 15, "hidden": (32,), "dropout": 0.0}
DATA = Path(os.environ.get("DEEPFSI_DATA") or ".") / "spc_modes"
real = pytest.mark.skipif(not DATA.is_dir(), reason="needs $DEEPFSI_DATA/spc_modes")
MODES = Variables("conv_cp", "digit", "ImageName", None, ("note_pump", "note_signal"))


CLASSES, EACH, MODES_MADE = 3, 400, 5


def drifting(order: str, drift: float = 3.0, seed: int = 0) -> MeasuredReadouts:
    """Readouts (n, k) of three classes under a random walk of the set-up, which a monitor reads.

    Files were recorded one after another, in "blocks", or in "turns", one at each place.
    """
    rng = np.random.default_rng(seed)
    count = CLASSES * EACH
    file, place = np.repeat(np.arange(CLASSES), EACH), np.tile(np.arange(float(EACH)), CLASSES)
    time = np.arange(count) if order == "blocks" else place.astype(int) * CLASSES + file
    walk = np.cumsum(rng.normal(size=count))
    state = (drift * (walk - walk.mean()) / walk.std())[time]
    centres = rng.normal(scale=2.0, size=(CLASSES, MODES_MADE))
    noise = rng.normal(size=(count, MODES_MADE))
    values = centres[file] + noise + np.outer(state, rng.normal(size=MODES_MADE))
    monitor = state[:, None] + rng.normal(scale=0.05, size=(count, 2))
    return MeasuredReadouts(
        name="made up", values=values, y=file, classes=("a", "b", "c"), file=file, position=place,
        ordered=False, picture=None, monitors={"laser": monitor},
    )  # fmt: skip


def measured(table, **training):
    designs = {split: learn_readouts(table, split, training=training) for split in table.splits}
    return measure_readouts(table, designs)


def test_the_unit_changes_nothing():
    table = drifting("turns", drift=0.5)
    volts = replace(table, values=-3e-6 + 2e-6 * table.values)
    ours, theirs = (
        classify_readouts(learn_readouts(each, training=FEW), each.values)
        for each in (table, volts)
    )
    assert np.allclose(ours.chances, theirs.chances, atol=1e-3)
    assert ours.outside == theirs.outside == 0
    # and what is outside of the span is not cut off: readouts are no reflectance
    far = classify_readouts(learn_readouts(table, training=FEW), table.values - 100)
    assert far.outside == 1
    assert far.scenes.max() < 0


@pytest.mark.parametrize(("order", "word"), [("blocks", "as a block"), ("turns", "took turns")])
def test_monitors_tell_the_order_of_files(order, word):
    for seed in range(5):
        found = measure_order(drifting(order, seed=seed))
        assert word in found.words
        assert (found.ratio.low > 1) == (order == "blocks")


def test_a_drift_is_named_where_the_last_part_is_worse():
    table = drifting("turns", drift=0.0)
    late = table.position > 0.8 * EACH - 1
    moved = replace(table, values=table.values - 6.0 * late[:, None])
    words = [
        next(line for line in measured(each, **FEW).verdict if line[:5] == "drift")
        for each in (table, moved)
    ]
    assert "no difference" in words[0]
    assert "flatters" in words[1]


@real
@pytest.mark.parametrize(
    ("folder", "ridge", "count"),
    [
        ("crystal27mm_sep7", 0.93, 6000),
        ("crystal40mm_sep21", 0.99, 2000),
        ("1f_july31", 0.76, 2000),
    ],
)
def test_real_readouts_as_well_as_ridge_and_recorded_in_turn(folder, ridge, count):
    table = read_readouts(DATA / folder, MODES)
    assert len(table.values) == count
    assert table.splits == ("random", "later")
    assert "took turns" in measure_order(table).words
    if folder != "1f_july31":  # the hardest of the small ones; each takes many seconds
        return
    found = measured(table, epochs=20)  # of 100, which reach 0.96
    random, later = found.splits
    assert random.network.high >= ridge
    assert random.network.mean > ridge - 0.01
    assert later.network.high < random.network.low
    assert found.monitors[0].ridge.low < 0.1
