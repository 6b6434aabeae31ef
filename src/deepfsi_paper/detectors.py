"""Number of detectors that one device needs: accuracy against photons and against detectors.

Each detector sees its own part of the device, and all see the same frames; impulse imaging has one
for each pixel. The targets are our own.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from math import prod

from deepfsi.base.numeric.intervals import Difference, accuracy_difference, all_above
from deepfsi.report.style import BUDGET_AXIS, DESIGN_COLOURS, photons_text
from deepfsi.sweeps.results import Point, Results
from deepfsi_paper.experiment import Experiment, Finding, budgets, cifar10_here
from deepfsi_paper.report.lines import Line, lines_figure
from deepfsi_paper.report.section import Claim, Picture, Table

NEAR = 0.02
"""Loss of accuracy against impulse imaging that still counts as near it."""

SCARCE = 1e5
"""Photons below which more detectors are expected to read more."""

Targets = Mapping[tuple[str, float], float]
"""Accuracy to be reached, by detectors and budget."""

TARGETS: Targets = {
    ("2x2", 1e3): 0.66,
    ("2x2", 1e4): 0.94,
    ("4x4", 1e3): 0.78,
    ("4x4", 1e4): 0.96,
}
"""On MNIST, of one device."""

PALETTE = ("raster", "hadamard", "truncated-hadamard", "pca", "deepfsi")
"""Designs whose colours lines take, one after another."""

Look = Mapping[str, object]
"""Keywords of matplotlib."""

REFERENCE: Look = {
    "color": DESIGN_COLOURS["impulse"],
    "marker": "s",
    "linestyle": (0, (7, 2, 1.2, 2)),
}
"""Line of impulse imaging."""

MASKS: Look = {"marker": "o"}
ON: Look = {"marker": ".", "linestyle": ":"}
"""Of lines of masks, and of one frame that is all ON."""

OWN_PAPER = (
    "Not in the paper, whose light law lets every mask see each pixel for the whole "
    "exposure, as a detector for each pixel would. One device with one detector shares the "
    "exposure among its frames."
)

Chosen = Mapping[tuple[int, float], Point]
"""Points at their chosen number of frames and start, by detectors and budget."""


def detectors_of(point: Point) -> int:
    """Number of detectors: of impulse imaging one for each pixel."""
    if point.every_pixel:
        return round(point.masks / point.ratio)
    return prod(map(int, point.detectors.split("x")))


def show(results: Results, targets: Targets) -> Finding:
    """Lines against photons and detectors, their table, and claims.

    Part `on` has one frame that is all ON; the others have masks.

    Parameters
    ----------
    results : Results
    targets : mapping
        Accuracies that are claimed to be reached.
    """
    fixed, on = (_chosen(results, alone) for alone in (False, True))
    return Finding(
        _found(results, fixed),
        (_picture(fixed, on),),
        (
            *_target_claims(fixed, targets),
            _more_claim(fixed),
            *_mask_claims(fixed, on),
        ),
        (_table(fixed, on),),
    )


def _chosen(results: Results, on: bool) -> Chosen:
    """Of each number of detectors and budget, the start that is best on validation images."""
    best = (p for p in results.points if p.best and (p.recipe == "on") == on)
    rising = sorted(best, key=lambda p: p.validation or 0.0)
    return {(detectors_of(point), point.photons): point for point in rising}


def _numbers(chosen: Chosen) -> list[int]:
    """Numbers of detectors, rising; that of impulse imaging is the last."""
    return sorted({detectors for detectors, _ in chosen})


def _found(results: Results, fixed: Chosen) -> str:
    lights = budgets(fixed.values())
    near = []
    for photons in lights:
        every = [fixed[each, photons] for each in _numbers(fixed) if (each, photons) in fixed]
        enough = next(p for p in every if p.accuracy >= every[-1].accuracy - NEAR)
        near.append(f"{detectors_of(enough)} at {photons_text(photons)} photons")
    return (
        f"{results.data.name}, non-negative frames on one device, tested under exact photon noise. "
        f"So many detectors come within {NEAR} of impulse imaging, which has one for each pixel: "
        f"{', '.join(near)}."
    )


def _target_claims(fixed: Chosen, targets: Targets) -> list[Claim]:
    points = {(point.detectors, point.photons): point for point in fixed.values()}
    claims = []
    for (detectors, photons), target in targets.items():
        point = points.get((detectors, photons))
        if point is None or point.every_pixel:
            continue
        holds = True if point.low >= target else False if point.high < target else None
        claims.append(
            Claim(
                f"{detectors} detectors read at least {target} at {photons_text(photons)} photons",
                holds,
                f"{point.accuracy:.3f} [{point.low:.3f}, {point.high:.3f}] with {_frames(point)}",
            )
        )
    return claims


def _more_claim(fixed: Chosen) -> Claim:
    numbers = _numbers(fixed)
    gains = {
        (few, many, photons): accuracy_difference(fixed[many, photons], fixed[few, photons])
        for few, many in pairwise(numbers)
        for photons in budgets(fixed.values())
        if photons < SCARCE
    }
    (few, many, photons), least = min(gains.items(), key=lambda item: item[1].low)
    return Claim(
        f"Below {photons_text(SCARCE)} photons more detectors read more, each step",
        all_above(gains.values()),
        f"least from {few} to {many} detectors at {photons_text(photons)} photons: {least}",
    )


def _mask_claims(fixed: Chosen, on: Chosen) -> list[Claim]:
    claims = []
    for detectors, gains in _gains(fixed, on).items():
        photons, least = min(gains.items(), key=lambda item: item[1].low)
        claims.append(
            Claim(
                f"With {_counted(detectors)} masks read more than one frame that is all ON, at "
                "every budget",
                all_above(gains.values()),
                f"least at {photons_text(photons)} photons: {least}",
            )
        )
    return claims


def _gains(first: Chosen, second: Chosen) -> dict[int, dict[float, Difference]]:
    """First less second, by detectors and by budget, both rising, where both were measured."""
    gains = defaultdict[int, dict[float, Difference]](dict)
    for place in sorted(first.keys() & second.keys()):
        detectors, photons = place
        gains[detectors][photons] = accuracy_difference(first[place], second[place])
    return gains


def _counted(detectors: int) -> str:
    return f"{detectors} detector{'s' if detectors > 1 else ''}"


def _frames(point: Point) -> str:
    return f"{point.masks} frame{'s' if point.masks > 1 else ''}"


def _picture(fixed: Chosen, on: Chosen) -> Picture:
    panels = {
        BUDGET_AXIS: _by_detectors(fixed),
        "number of detectors": [
            *_by_budget(fixed, MASKS, named=True),
            *_by_budget(on, ON),
        ],
    }
    return Picture(
        lines_figure(panels),
        "How many detectors do you need? Accuracy against photons, a line for each number of "
        "detectors, and against detectors, a line for each budget. Dotted: no masks, one frame "
        "that is all ON. Bars: 95 % intervals.",
        "Accuracy against photons and against the number of detectors; numbers in the table.",
    )


def _coloured(look: Look, place: int) -> Look:
    return {**look, "color": DESIGN_COLOURS[PALETTE[place % len(PALETTE)]]}


def _by_detectors(fixed: Chosen) -> list[Line]:
    *own, last = _numbers(fixed)
    lines = [_line(f"{last}, impulse imaging", REFERENCE, fixed, detectors=last)]
    for place, detectors in reversed(list(enumerate(own))):
        masks = _coloured(MASKS, place)
        lines.append(_line(_counted(detectors), masks, fixed, detectors=detectors))
    return lines


def _by_budget(chosen: Chosen, look: Look, *, named: bool = False) -> list[Line]:
    every = list(enumerate(budgets(chosen.values())))
    return [
        _line(
            f"{photons_text(photons)} photons" if named else "",
            _coloured(look, place),
            chosen,
            photons=photons,
        )
        for place, photons in reversed(every)
    ]


def _line(
    name: str,
    look: Look,
    chosen: Chosen,
    *,
    detectors: int | None = None,
    photons: float | None = None,
) -> Line:
    """Line of one number of detectors against photons, or of one budget against detectors."""
    at = (
        (place[0] if detectors is None else place[1], point)
        for place, point in chosen.items()
        if detectors in (None, place[0]) and photons in (None, place[1])
    )
    return Line.through(name, look, at)


def _table(fixed: Chosen, on: Chosen) -> Table:
    lights = budgets(fixed.values())
    rows = [
        *_rows(fixed, lights, "learned"),
        *_rows(on, lights, "one frame, all ON"),
    ]
    return Table(
        "Accuracy by detectors and photons, with the number of frames that validation chose, as it "
        "chose the masks that the training starts from",
        ("detectors", "masks", *(f"{photons_text(photons)} photons" for photons in lights)),
        tuple(rows),
    )


def _rows(
    chosen: Chosen, lights: Sequence[float], masks: str
) -> Iterable[tuple[int | str | None, ...]]:
    for detectors in _numbers(chosen):
        at = [chosen.get((detectors, photons)) for photons in lights]
        alone = any(point and point.every_pixel for point in at)
        cells = (
            f"{point.accuracy:.3f}" + ("" if alone else f" ({point.masks})") if point else None
            for point in at
        )
        yield (detectors, "impulse imaging" if alone else masks, *cells)


MNIST = Experiment(
    name="detectors",
    title="How many detectors do you need?",
    paper=OWN_PAPER,
    show=partial(show, targets=TARGETS),
)

CIFAR10 = Experiment(
    name="detectors-cifar10",
    title="How many detectors do you need on CIFAR-10?",
    paper=OWN_PAPER,
    show=partial(show, targets={}),
    adapt=cifar10_here,
)
