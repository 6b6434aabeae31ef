"""Rail sums: whether the light of a mask and its inverse is as constant as Poisson counts allow.

A mask and its inverse together send all the light to the detector, so that their counts have one
mean, and sums n of m pairs scatter as Poisson's: Σ (n - n̄)² / n̄ is a χ² of m - 1 degrees of
freedom. What they scatter more is measured as an excess relative variance,

    e = (s² - n̄) / n̄²,

and split: what is alike in several runs of the same masks belongs to masks and sequence; what is
not is a fluctuation of each run. Where the scatter lies is asked by leaving each pair out and
predicting it from others: its neighbours in time, its block, its place in the block, and masks
that are as fine as it.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import combinations
from typing import Any, Literal, get_args

import numpy as np

from deepfsi.base.errors import InputError, Message, check_choice
from deepfsi.hardware.light.curves import FALSE_ALARMS

CUTS = 20
"""Parts that a sequence is cut into, each of which is left out in turn for an interval."""

LEAST_PAIRS = 2 * CUTS
"""Pairs of pictures below which no verdict is given."""

LEAST_COUNTS = 5.0
"""Counts of a rail sum in the mean below which χ² tells nothing."""

LAGS = (1, 2, 4, 8, 16, 32)
"""Distances in pairs at which the autocorrelation is given."""

ORDERS = 999
"""Random orders that a place in the sequence is compared with."""

ALIKE = 8
"""Masks of like fineness that predict one."""

CAUSES = {
    "fineness": "masks of like fineness",
    "sequence": "pictures before and after",
    "block": "the block",
    "place in block": "the place in the block",
}
"""Words for what predicts rail sums."""

LEAST_PRINTED_CHANCE = 1e-300
"""Chance below which no number is said."""


@dataclass(frozen=True)
class Excess:
    """Excess relative variance of the light, with its 95 % interval."""

    variance: float  # relative variance beyond that of Poisson counts
    low: float
    high: float

    @property
    def spread(self) -> float:
        """Relative standard deviation; 0 where Poisson counts scatter as much."""
        return float(np.sqrt(max(self.variance, 0.0)))

    def __str__(self) -> str:
        low, high = (max(end, 0.0) ** 0.5 for end in (self.low, self.high))
        return f"{self.spread:.1%} ({low:.1%} to {high:.1%})"


@dataclass(frozen=True)
class RunScatter:
    """Scatter of the rail sums of one run."""

    mean: float  # counts
    spread: float  # relative standard deviation
    allowed: float  # that of Poisson counts
    chi2: float  # per degree of freedom
    chance: float  # of so large a χ² for Poisson counts
    excess: Excess
    autocorrelation: tuple[float, ...]  # of the excess, at `LAGS`


@dataclass(frozen=True)
class Cause:
    """Predictor of rail sums: its share of their variance, and the chance of it in random order."""

    share: float
    chance: float
    rest: float | None = None  # share of what fineness leaves


@dataclass(frozen=True)
class RailSums:
    """Verdict on the light of runs with the same masks."""

    pairs: int  # pairs of a mask and its inverse
    poisson: bool  # True if all runs and tests agree with Poisson counts of a constant light
    runs: tuple[RunScatter, ...]
    causes: Mapping[str, Cause]
    chi2_counts: float | None = None
    chance_counts: float | None = None
    chi2_sums: float | None = None
    correlations: tuple[float, ...] = ()  # of the sums of two runs each
    common: Excess | None = None
    own: tuple[Excess, ...] = field(default=())  # of each run by itself
    own_autocorrelation: tuple[float, ...] = ()  # of that, at `LAGS`
    pictures: tuple[Excess, ...] = ()  # that of each run, of single pictures

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers for JSON."""
        return asdict(self) | {"lags": LAGS}

    def lines(self, names: Sequence[str]) -> Iterator[str]:
        """Say whether the counts of runs with these names are Poisson, and what else they are."""
        yield (
            "these counts are Poisson, as far as they tell"
            if self.poisson
            else "THESE COUNTS ARE NOT POISSON"
        )
        for name, run in zip(names, self.runs, strict=True):
            yield (
                f"  {name}: sums of a mask and its inverse, {run.mean:.0f} in the mean, scatter by "
                f"{run.spread:.1%} where Poisson allows {run.allowed:.1%} (chi2/dof "
                f"{run.chi2:.3g}, p {_chance_text(run.chance)}); excess {run.excess}"
            )
        if self.common is not None:
            yield from self._lines_between(self.common)
        for name, cause in self.causes.items():
            rest = "" if cause.rest is None else f"; {max(cause.rest, 0):.0%} of what is left then"
            yield (
                f"  predicted by {CAUSES[name]}: {max(cause.share, 0):.0%} of the scatter "
                f"(p {_chance_text(cause.chance)}){rest}"
            )

    def _lines_between(self, common: Excess) -> Iterator[str]:
        """Say what several runs have in common, and what each has by itself."""
        variances = [
            1 + excess.variance * run.mean for excess, run in zip(self.own, self.runs, strict=True)
        ]
        fluctuation = max(excess.spread for excess in self.pictures)
        yield (
            f"  alike in all tables (r {range_text(self.correlations, '.2f')}): {common}, of the "
            "masks or the sequence"
        )
        yield (
            f"  of each table by itself: {', '.join(map(str, self.own))}: variance "
            f"{range_text(variances, '.2f')} times Poisson's"
        )
        yield (
            f"  of single pictures: {', '.join(map(str, self.pictures))}; the virtual camera draws "
            f"it with fluctuation = {fluctuation:.2g}"
        )
        yield (
            f"  between tables: chi2/dof of single counts {self.chi2_counts:.2f} "
            f"(p {_chance_text(self.chance_counts or 0)}), of sums {self.chi2_sums:.2f}"
        )
        yield (
            "  autocorrelation of what differs, at a lag of 1 pair "
            f"{self.own_autocorrelation[0]:.2f}, of 8 pairs {self.own_autocorrelation[3]:.2f}"
        )


def range_text(values: Iterable[float], form: str) -> str:
    """Least and largest of some numbers, each in this form; once if they are alike."""
    numbers = list(values)
    ends = [format(end, form) for end in (min(numbers), max(numbers))]
    return " to ".join(dict.fromkeys(ends))


def _chance_text(chance: float) -> str:
    return f"{chance:.1g}" if chance > LEAST_PRINTED_CHANCE else f"< {LEAST_PRINTED_CHANCE:.0e}"


def fineness(masks: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Sign changes of each mask along each axis, of a line in the mean."""
    lit = masks.reshape(-1, *shape) > 0
    axes = tuple(range(1, lit.ndim))
    lines = [lit[0].size / side for side in shape]
    changes = [np.diff(lit, axis=axis).sum(axis=axes) for axis in axes]
    return np.stack([total / many for total, many in zip(changes, lines, strict=True)], axis=1)


def check_rail_sums(
    runs: np.ndarray,
    fine: np.ndarray,
    order: np.ndarray | None = None,
    block: int | None = None,
) -> RailSums | None:
    """Test whether rail sums scatter as Poisson counts of a constant light do."""
    sums = runs.sum(axis=1)
    pairs = sums.shape[1]
    if pairs < LEAST_PAIRS or sums.mean(axis=1).min() < LEAST_COUNTS:
        return None
    scatter = tuple(_scatter(row) for row in sums)
    tests = [each.chance for each in scatter]
    relative = sums / sums.mean(axis=1, keepdims=True)
    several: dict[str, Any] = {}
    if len(runs) > 1:
        several = _compare(runs, sums, relative)
        tests.append(several["chance_counts"])
    poisson = min(tests) * len(tests) > FALSE_ALARMS
    place = np.arange(pairs) if order is None else order
    causes = {} if poisson else _find_causes(relative.mean(axis=0), fine, place, block)
    return RailSums(pairs, poisson, scatter, causes, **several)


def _homogeneity(counts: np.ndarray) -> tuple[float, float]:
    """χ² per degree of freedom between rows of counts (runs, n) of one shape, and its chance."""
    from scipy.special import chdtrc

    lit = counts.sum(axis=0) >= LEAST_COUNTS * len(counts)
    held = counts[:, lit]
    expected = held.sum(axis=0) * (held.sum(axis=1) / held.sum())[:, None]
    chi2 = float(((held - expected) ** 2 / expected).sum())
    free = (len(held) - 1) * (int(lit.sum()) - 1)
    return chi2 / free, float(chdtrc(free, chi2))


def _scatter(row: np.ndarray) -> RunScatter:
    """Scatter of rail sums (m,)."""
    from scipy.special import chdtrc

    mean = float(row.mean())
    chi2 = float(((row - mean) ** 2).sum() / mean)
    relative = row / mean
    free = len(row) - 1
    return RunScatter(
        mean=mean,
        spread=float(relative.std(ddof=1)),
        allowed=mean**-0.5,
        chi2=chi2 / free,
        chance=float(chdtrc(free, chi2)),
        excess=_intervals(lambda kept: np.array([_excess(row[kept])]), len(row))[0],
        autocorrelation=_autocorrelation(relative, 1 / mean),
    )


def _excess(row: np.ndarray) -> float:
    """Relative variance of sums beyond Poisson's."""
    mean = float(row.mean())
    return float(row.var(ddof=1) - mean) / mean**2


def _compare(runs: np.ndarray, sums: np.ndarray, relative: np.ndarray) -> dict[str, Any]:
    """Excess that runs have in common, and that of each by itself, as of `RailSums`."""
    (number, pairs) = sums.shape
    pairwise = list(combinations(range(len(sums)), 2))
    noise = 1 / sums.mean(axis=1)

    def split(kept: np.ndarray) -> np.ndarray:
        """Common excess, then that of each run."""
        found = np.cov(relative[:, kept])
        apart = [found[i, j] for i, j in pairwise]
        # What two runs differ by is their own; of three or more, each run's follows from its pairs
        different = found.diagonal()[:, None] + found.diagonal() - 2 * found
        return np.array([np.mean(apart), *_own(different - noise[:, None] - noise)])

    excess = _intervals(split, pairs)
    pictures = _intervals(lambda kept: _of_pictures(runs[:, :, kept]), pairs)
    lagged = [_autocorrelation(relative[i] - relative[j], noise[i] + noise[j]) for i, j in pairwise]
    correlation = np.corrcoef(relative)
    chi2, chance = _homogeneity(runs.reshape(number, -1))
    return {
        "chi2_counts": chi2,
        "chance_counts": chance,
        "chi2_sums": _homogeneity(sums)[0],
        "correlations": tuple(float(correlation[i, j]) for i, j in pairwise),
        "common": excess[0],
        "own": tuple(excess[1:]),
        "pictures": tuple(pictures),
        "own_autocorrelation": tuple(np.mean(lagged, axis=0).tolist()),
    }


def _of_pictures(runs: np.ndarray) -> np.ndarray:
    """Excess relative variance of single pictures that each run (runs, 2, m) has by itself."""
    # y_k = t (1 + ε_k) a_k and Poisson noise: two runs' y / t differ by (f² + f'²) a² and by noise
    counts = runs.reshape(len(runs), -1)
    times = counts.mean(axis=1)
    light = counts.sum(axis=0) / times.sum()
    rates = counts / times[:, None]
    different = ((rates[:, None] - rates) ** 2).sum(axis=2)
    noise = light.sum() * (1 / times[:, None] + 1 / times)
    # a² is known with the noise of its own
    return _own((different - noise) / (light**2 - light / times.sum()).sum())


def _own(different: np.ndarray) -> np.ndarray:
    """Excess of each run, of what two each differ by; of two runs the mean of both."""
    number = len(different)
    np.fill_diagonal(different, 0.0)
    each = different.sum(axis=1)
    total = each.sum() / (2 * (number - 1))
    return np.asarray((each - total) / (number - 2) if number > 2 else each / 2)


def _find_causes(
    sums: np.ndarray, fine: np.ndarray, place: np.ndarray, block: int | None
) -> dict[str, Cause]:
    """Shares of the scatter of rail sums (m,) that each place of a pair predicts."""
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(0)
    pairs = len(sums)
    nearest = cKDTree(fine).query(fine, min(ALIKE + 1, pairs))[1]

    def like(row: np.ndarray) -> np.ndarray:
        others = np.where(nearest == np.arange(pairs)[:, None], np.nan, row[nearest])
        return np.asarray(np.nanmean(others, axis=1))

    predictors: dict[str, Callable[[np.ndarray], np.ndarray]] = {}
    predictors |= {"fineness": like, "sequence": _neighbours}
    if block:
        many = max(block // 2, 1)
        predictors["block"] = lambda row: _others(row, place // many)
        predictors["place in block"] = lambda row: _others(row, place % many)
    orders = [rng.permutation(pairs) for _ in range(ORDERS)]
    rest = sums - like(sums)
    causes = {}
    for name, predict in predictors.items():
        share = _share(sums, predict(sums))
        by_chance = [_share(sums[order], predict(sums[order])) for order in orders]
        chance = (1 + sum(found >= share for found in by_chance)) / (1 + ORDERS)
        left = None if name == "fineness" else _share(rest, predict(rest))
        causes[name] = Cause(share, chance, left)
    return causes


def _neighbours(row: np.ndarray) -> np.ndarray:
    """Mean of the pairs before and after each."""
    return (np.r_[row[1], row[:-1]] + np.r_[row[1:], row[-2]]) / 2


def _others(row: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Mean of the other members of each one's group; of all where it is alone."""
    number = np.bincount(group)
    total = np.bincount(group, row)
    others = (total[group] - row) / np.maximum(number[group] - 1, 1)
    return np.where(number[group] > 1, others, row.mean())


def _share(row: np.ndarray, prediction: np.ndarray) -> float:
    """Share of the variance that a prediction of left-out values explains."""
    return float(1 - ((row - prediction) ** 2).sum() / ((row - row.mean()) ** 2).sum())


def _autocorrelation(row: np.ndarray, noise: float) -> tuple[float, ...]:
    """Autocorrelation at `LAGS` of what scatters beyond the counting noise; NaN without it."""
    centred = row - row.mean()
    excess = float(centred.var()) - noise
    if excess <= 0:
        return (float("nan"),) * len(LAGS)
    return tuple(float((centred[lag:] * centred[:-lag]).mean() / excess) for lag in LAGS)


def _intervals(statistics: Callable[[np.ndarray], np.ndarray], number: int) -> list[Excess]:
    """Statistics of a sequence, with the intervals of leaving each part out in turn."""
    from scipy.special import stdtrit

    # Parts that follow each other keep the correlation of neighbours (block jackknife)
    place = np.arange(number)
    parts = np.array_split(place, CUTS)
    left = np.stack([statistics(np.delete(place, part)) for part in parts])
    error = np.sqrt((CUTS - 1) / CUTS * ((left - left.mean(axis=0)) ** 2).sum(axis=0))
    half = stdtrit(CUTS - 1, 0.975) * error
    ends = zip(statistics(place).tolist(), half.tolist(), strict=True)
    return [Excess(value, value - width, value + width) for value, width in ends]


Layout = Literal["columns", "turns", "halves", "single"]
"""Masks and inverses side by side, in turn, all masks before all inverses, or masks alone."""

LAYOUTS = get_args(Layout)
"""Names of the layouts."""


def split_rails(values: np.ndarray, layout: str | None, masks: int | None, name: str) -> np.ndarray:
    """Counts of the rails in the order in which they were shown."""
    if layout is not None:
        check_choice(Message("{rails}", setting="rails"), layout, LAYOUTS)
    shape = f"{name} has {values.shape[0]} rows and {values.shape[1]} columns"
    upright = values if values.shape[0] >= values.shape[1] else values.T
    wide = upright.shape[1]
    if wide == 1 and layout is None:
        if masks not in (len(upright), len(upright) / 2):
            raise InputError(
                "{shape}, in which masks and inverses may stand in several ways: say {rails} "
                "turns, halves or single",
                setting="rails",
                shape=shape,
            )
        if masks != len(upright):
            raise InputError(
                "{shape}, for {masks} masks: say {rails} turns or halves",
                setting="rails",
                shape=shape,
                masks=masks,
            )
        layout = "single"
    if wide == 2 and layout in (None, "columns"):
        rails = upright.T
    elif wide == 1 and layout != "columns":
        if layout != "single" and len(upright) % 2:
            raise InputError(f"{shape}: masks and their inverses are an even number of values")
        turns = upright.reshape(-1, 1 if layout == "single" else 2).T
        rails = upright.reshape(2, -1) if layout == "halves" else turns
    else:
        raise InputError(
            "{shape}: give a column of masks and one of inverses ({rails} columns), or all in one "
            "column ({rails} turns, halves or single)",
            setting="rails",
            shape=shape,
        )
    if masks is not None and rails.shape[1] != masks:
        raise InputError(
            "{shape}, which are {count} masks, and {masks} are needed: give the masks that were "
            "shown, or another layout of {rails}",
            setting="rails",
            shape=shape,
            count=rails.shape[1],
            masks=masks,
        )
    return np.ascontiguousarray(rails)
