"""Classifiers of measured readouts, and tests of how much of their accuracy is the recording's.

A network learns the readouts themselves, by the design `impulse` without noise: no mask is known.
Beside it stands RBF kernel ridge. A random split tests between recordings that were trained on a
moment before and after; that is why the last fifth of each class, and pictures not seen, are tested
too, and whether the order of recording or the monitors of the light tell the class alone.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from deepfsi.base.numeric.intervals import Interval, accuracy_interval, student, wilson
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import Table
from deepfsi.datasets.readouts import MeasuredReadouts
from deepfsi.design.design import Design
from deepfsi.design.readouts import READOUT_PHOTONS, classify_readouts
from deepfsi.designfile.provenance import READOUTS
from deepfsi.jobs.training import READOUTS_TRAINING
from deepfsi.training.learning import learn

SPLIT_WORDS = {
    "random": "a random fifth",
    "later": "the last fifth of each class",
    "pictures": "pictures not seen",
}
"""Splits in words."""

MOST_RIDGE = 5000
"""Recordings that kernel ridge is fitted to, at most: its memory is their square."""

RIDGE = 1e-2
"""Penalty of kernel ridge."""

SEGMENTS = 20
"""Parts of the recording by which the order is tested."""

LEAST_DRIFT = 1e-12
"""Step of monitors that is taken for none, so that its logarithm is a number."""


@dataclass(frozen=True)
class SplitTest:
    """Accuracy of the network and of kernel ridge on one split, each with its 95 % interval."""

    split: str
    train: int
    test: int
    network: Interval
    ridge: Interval

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return vars(self) | {"network": self.network._asdict(), "ridge": self.ridge._asdict()}


@dataclass(frozen=True)
class MonitorTest:
    """Accuracy of kernel ridge that reads monitors alone, tested on the random split."""

    name: str
    ridge: Interval


@dataclass(frozen=True)
class OrderTest:
    """Test of the order in which classes were recorded.

    Of known order, `neighbour` is how often the next recording is of the same class. Else the files
    may follow one another, or take turns: the monitors drift, and change least between neighbours
    in time. Steps are mean squared changes over twice the variance, 1 for no relation.
    """

    neighbour: Interval | None = None
    by_chance: float | None = None  # the same in a random order
    in_blocks: float | None = None
    in_turn: float | None = None
    ratio: Interval | None = None  # of these steps, turns over blocks: their mean logarithm

    @property
    def words(self) -> str:
        """Finding in one sentence."""
        if self.neighbour is not None and self.by_chance is not None:
            together = self.neighbour.low > self.by_chance
            return (
                f"of recordings that follow each other {_percent(self.neighbour)} are of one "
                f"class, in a random order {self.by_chance:.1%}: class and time "
                f"{'cannot be told apart' if together else 'differ'}"
            )
        if self.ratio is None:
            return (
                "the order of recording is not known: the files may follow one another, so that "
                "class and time cannot be told apart; name the variable of the order, or monitors"
            )
        steps = (
            f"the monitors change by {self.in_turn:.3g} from file to file at one place, and by "
            f"{self.in_blocks:.3g} from place to place in one file (ratio {self.ratio.text})"
        )
        if self.ratio.high < 1:
            return f"the files took turns, place by place, so that class and time differ: {steps}"
        if self.ratio.low > 1:
            return f"each file was recorded as a block, so that class and time are one: {steps}"
        return f"whether files took turns or were blocks cannot be told: {steps}"


@dataclass(frozen=True)
class ReadoutsResult:
    """Accuracy of classifiers of measured readouts, and of whatever else tells the class."""

    recordings: int
    readouts: int
    classes: tuple[str, ...]
    chance: float  # share of the commonest class
    splits: tuple[SplitTest, ...]
    monitors: tuple[MonitorTest, ...]
    order: OrderTest

    def test(self, split: str) -> SplitTest:
        """Test of a split."""
        return next(test for test in self.splits if test.split == split)

    @property
    def verdict(self) -> tuple[str, ...]:
        """Findings, one a line."""
        random = self.test("random").network
        later = self.test("later").network
        lines = [f"order: {self.order.words}"]
        for test in self.monitors:
            tells = test.ridge.low > self.chance
            lines.append(
                f"monitors: {test.name} alone {'tells' if tells else 'does not tell'} the class: "
                f"{test.ridge.text}, chance {self.chance:.3f}"
            )
        # the interval of the difference of two rates, by Newcombe's method
        apart = math.hypot(random.mean - random.low, later.high - later.mean)
        if random.mean - later.mean > apart:
            lines.append(
                f"drift: {later.text} on the last fifth of each class, {random.text} on a "
                "random fifth: the random split flatters, as it tests between recordings that it "
                "was trained on; expect the lower one of tomorrow's recordings"
            )
        else:
            lines.append(
                f"drift: {later.text} on the last fifth of each class, {random.text} on a "
                "random fifth: no difference that these numbers of recordings show"
            )
        pictures = [test.network for test in self.splits if test.split == "pictures"]
        lines.append(
            f"pictures: {pictures[0].text} on pictures that were not trained on"
            if pictures
            else "pictures: none is known to be recorded twice: every split tests new ones"
        )
        return tuple(lines)

    def lines(self, name: str) -> Iterator[str | Table]:
        """Say what the classifiers of a table with this name are worth."""
        rows = [
            (
                SPLIT_WORDS[split.split],
                str(split.train),
                str(split.test),
                split.network.text,
                split.ridge.text,
            )
            for split in self.splits
        ]
        rows += [
            (f"{monitor.name} alone, a random fifth", "", "", "", monitor.ridge.text)
            for monitor in self.monitors
        ]
        yield Table(
            f"{name}: {self.recordings} recordings of {self.readouts} readouts, "
            f"{len(self.classes)} classes, guessing {self.chance:.3f}",
            ("tested on", "trained", "tested", "network (95 %)", "RBF ridge (95 %)"),
            rows,
        )
        yield from self.verdict

    @property
    def figure_rows(self) -> list[tuple[str, Interval | None, Interval | None]]:
        """Accuracies of the network and of kernel ridge, each after what they were tested on."""
        return [
            *((SPLIT_WORDS[test.split], test.network, test.ridge) for test in self.splits),
            *((f"{test.name} alone", None, test.ridge) for test in self.monitors),
        ]

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        order = {
            name: value._asdict() if isinstance(value, Interval) else value
            for name, value in vars(self.order).items()
        }
        return {
            **{name: getattr(self, name) for name in ("recordings", "readouts", "classes")},
            "chance": self.chance,
            "splits": [test.as_dict() for test in self.splits],
            "monitors": [{"name": m.name, **m.ridge._asdict()} for m in self.monitors],
            "order": order,
            "verdict": list(self.verdict),
        }


def _percent(found: Interval) -> str:
    return f"{found.mean:.1%} ({found.low:.1%} to {found.high:.1%})"


def learn_readouts(
    readouts: MeasuredReadouts,
    split: str = "random",
    *,
    training: Mapping[str, Any] | None = None,
    seed: int = 0,
    device: str | torch.device = "auto",
    report: Progress = SILENT,
) -> Design:
    """Train a classifier on the training part of a split of measured readouts.

    It holds the offset and the gain of each readout, and no masks: `classify_readouts` reads new
    ones in the detector's unit.
    """
    made = learn(
        readouts.dataset(split, seed),
        design="impulse",
        masks=readouts.values.shape[1],
        photons=READOUT_PHOTONS,
        camera={"noise": "none"},
        training={**READOUTS_TRAINING, **(training or {})},
        seed=seed,
        device=device,
        report=report,
    )
    scale = {"offset": readouts.offset.tolist(), "gain": readouts.gain.tolist()}
    made.info[READOUTS] = {**scale, "split": split}
    assert isinstance(made, Design)
    return made


def measure_readouts(
    readouts: MeasuredReadouts, designs: Mapping[str, Design], seed: int = 0
) -> ReadoutsResult:
    """Test designs of `learn_readouts`, and what else tells the class."""
    splits = []
    for split, design in designs.items():
        test = readouts.test_part(split, seed)
        answers = classify_readouts(design, readouts.values[test]).chances.argmax(axis=1)
        splits.append(
            SplitTest(
                split,
                train=int((~test).sum()),
                test=int(test.sum()),
                network=accuracy_interval((answers == readouts.y[test]).astype(float)),
                ridge=_ridge(readouts.values, readouts.y, test, seed),
            )
        )
    test = readouts.test_part("random", seed)
    monitors = [
        MonitorTest(name, _ridge(_ranks(values), readouts.y, test, seed))
        for name, values in readouts.monitors.items()
        if np.ptp(values, axis=0).any()
    ]
    recordings, count = readouts.values.shape
    return ReadoutsResult(
        recordings=recordings,
        readouts=count,
        classes=readouts.classes,
        chance=float(np.bincount(readouts.y).max() / len(readouts.y)),
        splits=tuple(splits),
        monitors=tuple(monitors),
        order=measure_order(readouts),
    )


def _ranks(values: np.ndarray) -> np.ndarray:
    """Values (n, q) by their ranks, 0 to 1: monitors have outliers, as lasers do."""
    from scipy.stats import rankdata

    return np.asarray(rankdata(values, axis=0)) / len(values)


def _ridge(values: np.ndarray, y: np.ndarray, test: np.ndarray, seed: int) -> Interval:
    """Accuracy on `test` (n,) of RBF kernel ridge of values (n, q), standardised."""
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.preprocessing import StandardScaler

    train = np.flatnonzero(~test)
    if len(train) > MOST_RIDGE:
        train = np.random.default_rng(seed).choice(train, MOST_RIDGE, replace=False)
    scaled = StandardScaler().fit(values[train])
    model = KernelRidge(kernel="rbf", alpha=RIDGE)
    model.fit(scaled.transform(values[train]), 2.0 * np.eye(int(y.max()) + 1)[y[train]] - 1)
    answers = model.predict(scaled.transform(values[test])).argmax(axis=1)
    return accuracy_interval((answers == y[test]).astype(float))


def measure_order(readouts: MeasuredReadouts) -> OrderTest:
    """Test whether class and time of recording can be told apart."""
    if readouts.ordered:
        labels = readouts.y[np.argsort(readouts.position, kind="stable")]
        same = float((labels[1:] == labels[:-1]).mean())
        shares = np.bincount(labels) / len(labels)
        found = Interval(same, *wilson(same, len(labels) - 1))
        return OrderTest(found, float(np.square(shares).sum()))
    monitors = [monitor for monitor in readouts.monitors.values() if np.ptp(monitor, axis=0).any()]
    if not monitors:
        return OrderTest()
    values = _ranks(np.concatenate(monitors, axis=1))
    values = values[:, np.ptp(values, axis=0) > 0]
    files = [values[readouts.file == number] for number in range(int(readouts.file.max()) + 1)]
    count = min(map(len, files))
    places = np.stack([file[:count] for file in files], axis=1)  # (places, files, q)
    spread = 2 * values.var(axis=0).mean()
    blocks, turns = (
        np.square(np.diff(places, axis=axis)).mean(axis=(1, 2))[: count - 1] / spread
        for axis in (0, 1)
    )
    # over segments, as neighbours are alike; in logarithms, as a few jumps would outweigh the rest
    parts = zip(
        *(np.array_split(order, min(SEGMENTS, count - 1)) for order in (turns, blocks)), strict=True
    )
    logs = [float(np.log((a.mean() + LEAST_DRIFT) / (b.mean() + LEAST_DRIFT))) for a, b in parts]
    ends = (float(np.mean(logs)), *student(logs))
    return OrderTest(
        in_blocks=float(blocks.mean()),
        in_turn=float(turns.mean()),
        ratio=Interval(*np.exp(ends).tolist()),
    )
