"""Adaptive masks against masks that are known before: accuracy, information, and the clock.

The targets are our own.
"""

import math
from collections.abc import Callable, Iterable, Mapping

import numpy as np
from pydantic import TypeAdapter

from deepfsi.base.numeric.intervals import Difference, accuracy_difference, all_above, signed_text
from deepfsi.report.style import BUDGET_AXIS, DESIGN_COLOURS, photons_text
from deepfsi.sweeps.results import Point, Results
from deepfsi_paper.adaptive.clock import LEAST_LEFT, Measures, Rival, best_at, measure, rivals
from deepfsi_paper.adaptive.figures import clock_figure
from deepfsi_paper.experiment import Experiment, Finding, budgets
from deepfsi_paper.report.lines import Line, lines_figure
from deepfsi_paper.report.section import Claim, Picture, Table

TARGETS: Mapping[tuple[str, float], float] = {
    ("1x1", 1e3): 0.61,
    ("1x1", 1e4): 0.96,
    ("1x1", 1e5): 0.98,
    ("2x2", 1e3): 0.72,
    ("2x2", 1e4): 0.965,
}
"""Accuracy of adaptive masks to be reached, by detectors and budget."""

GAINED = (1e3, 1e4)
"""Budgets at which adaptive masks are expected to gain."""

BRIGHT = 1e5
"""Budget at which learned masks are expected to read more."""

WALLS_S = (0.1, 1.0)
"""Lengths of exposures by the clock."""

PER_DECADE = 40
"""Fluxes at which exposures of one length are compared."""

DETECTORS = {"1x1": "one detector", "2x2": "2 × 2 detectors"}

Look = Mapping[str, object]
"""Keywords of matplotlib."""

KINDS: dict[str, tuple[str, Look]] = {
    "impulse": (
        "impulse imaging",
        {"color": DESIGN_COLOURS["impulse"], "marker": "s", "linestyle": (0, (7, 2, 1.2, 2))},
    ),
    "adaptive": ("adaptive masks", {"color": DESIGN_COLOURS["adaptive"], "marker": "o"}),
    "fixed": ("learned masks", {"color": DESIGN_COLOURS["deepfsi"], "marker": "^"}),
}
"""Names of the kinds of designs in figures, and their lines."""

PALETTE = ("pca", "truncated-hadamard", "deepfsi", "control", "impulse")
"""Designs whose colours lines of budgets take, one after another."""

OWN_PAPER = "Not in the paper, whose masks are known before the exposure."

Chosen = Mapping[float, Point]
"""Points of one kind and one number of detectors by budget, each the best on validation images."""


def kind_of(point: Point) -> str:
    """Kind of a point, a key of `KINDS`."""
    return point.design if point.design in KINDS else point.recipe.split("-")[0]


def of_kind(results: Results, kind: str, detectors: str) -> list[Point]:
    """Points of a kind; impulse imaging has as many detectors as pixels beside any number."""
    return [
        point
        for point in results.points
        if kind_of(point) == kind and (kind == "impulse" or point.detectors == detectors)
    ]


def chosen(points: Iterable[Point]) -> Chosen:
    """Of each budget the point that is best on validation images."""
    rising = sorted(points, key=lambda point: point.validation or 0.0)
    return {point.photons: point for point in sorted(rising, key=lambda point: point.photons)}


def bits(point: Point, measures: Measures) -> float:
    """Bits that the answers tell of the class, at least: entropy less cross entropy."""
    return max(0.0, measures.entropy - (point.log_loss or 0.0) / math.log(2))


def show(results: Results) -> Finding:
    """Lines against photons, looks, prior and flux, their table, and claims."""
    measures = TypeAdapter(Measures).validate_python(results.extra)
    kinds = {
        (kind, detectors): chosen(of_kind(results, kind, detectors))
        for detectors in DETECTORS
        for kind in KINDS
    }
    return Finding(
        _found(results, kinds, measures),
        (
            _against_photons(kinds),
            _against_looks(results, measures),
            _information(kinds, measures),
            _clock(results, measures),
        ),
        (
            *_target_claims(kinds),
            *_gain_claims(kinds),
            _look_claim(results),
            *_prior_claim(results, measures),
            *(_clock_claim(results, measures, wall) for wall in WALLS_S),
        ),
        (_table(kinds, measures),),
    )


def _found(results: Results, kinds: Mapping[tuple[str, str], Chosen], measures: Measures) -> str:
    own = kinds["adaptive", "1x1"]
    said = ", ".join(
        f"{point.accuracy:.3f} ({_bits(point, measures)}) at {photons_text(photons)} photons"
        for photons, point in own.items()
    )
    return (
        f"{results.data.name}, one device and one detector, exact photon noise: adaptive masks "
        f"read {said}. A number of bits is what the answers tell of the class, at least; all of "
        f"it is {measures.entropy:.2f}."
    )


def _bits(point: Point, measures: Measures) -> str:
    return f"{bits(point, measures):.2f} bits"


def _target_claims(kinds: Mapping[tuple[str, str], Chosen]) -> Iterable[Claim]:
    for (detectors, photons), target in TARGETS.items():
        point = kinds["adaptive", detectors].get(photons)
        if point is None:
            continue
        holds = True if point.low >= target else False if point.high < target else None
        yield Claim(
            f"Adaptive masks with {DETECTORS[detectors]} read at least {target} at "
            f"{photons_text(photons)} photons",
            holds,
            f"{point.accuracy:.3f} [{point.low:.3f}, {point.high:.3f}] in {point.masks} looks",
        )


def _gain_claims(kinds: Mapping[tuple[str, str], Chosen]) -> Iterable[Claim]:
    for detectors, name in DETECTORS.items():
        own = kinds["adaptive", detectors]
        known = kinds["fixed", detectors]
        gains = {
            photons: accuracy_difference(own[photons], known[photons])
            for photons in own.keys() & known.keys()
        }
        early = {photons: gains[photons] for photons in GAINED if photons in gains}
        if early:
            yield Claim(
                f"With {name} adaptive masks read more than learned masks at "
                f"{' and '.join(map(photons_text, early))} photons",
                all_above(early.values()),
                _said(early),
            )
        if BRIGHT in gains and detectors == "1x1":
            yield Claim(
                f"With {name} learned masks read more than adaptive masks at "
                f"{photons_text(BRIGHT)} photons",
                all_above([-gains[BRIGHT]]),
                f"{-gains[BRIGHT]}, of {own[BRIGHT].masks} looks",
            )


def _said(gains: Mapping[float, Difference]) -> str:
    each = (f"{gain} at {photons_text(photons)} photons" for photons, gain in gains.items())
    return ", ".join(each)


def _of_largest_prior(results: Results) -> list[Point]:
    """Points of one detector of the part and variant that was tried with most numbers of looks."""
    every = of_kind(results, "adaptive", "1x1")
    tried: dict[tuple[str, str], set[int]] = {}
    for point in every:
        tried.setdefault((point.recipe, point.variant), set()).add(point.masks)
    most = max(len(masks) for masks in tried.values())
    last = [own for own, masks in tried.items() if len(masks) == most][-1]
    return [point for point in every if (point.recipe, point.variant) == last]


def _look_claim(results: Results) -> Claim:
    points = _of_largest_prior(results)
    few, many = min(p.masks for p in points), max(p.masks for p in points)
    at = {(point.photons, point.masks): point for point in points}
    gains = {each: accuracy_difference(at[each, many], at[each, few]) for each in budgets(points)}
    return Claim(
        f"{many} looks read more than {few}, at every budget",
        all_above(gains.values()),
        _said(gains),
    )


def _by_prior(results: Results, measures: Measures) -> dict[float, dict[float, Point]]:
    """Points by budget and by the size of the prior, of the most looks that all priors have."""
    sizes = {(prior.recipe, prior.variant): prior.scenes for prior in measures.priors}
    every = of_kind(results, "adaptive", "1x1")
    looks: dict[int, set[int]] = {}
    for point in every:
        looks.setdefault(sizes[point.recipe, point.variant], set()).add(point.masks)
    common = set.intersection(*looks.values())
    found: dict[float, dict[float, Point]] = {}
    for point in every:
        if common and point.masks == max(common):
            found.setdefault(point.photons, {})[sizes[point.recipe, point.variant]] = point
    return {photons: dict(sorted(found[photons].items())) for photons in sorted(found)}


def _prior_claim(results: Results, measures: Measures) -> Iterable[Claim]:
    found = _by_prior(results, measures)
    gains, looks = {}, 0
    for photons, by_size in found.items():
        *_, second, largest = by_size.values() if len(by_size) > 1 else (None, None)
        if second and largest:
            gains[photons], looks = accuracy_difference(largest, second), largest.masks
    if gains:
        yield Claim(
            f"The largest prior reads more than the second, in {looks} looks at every budget",
            all_above(gains.values()),
            _said(gains),
        )


def _fluxes(results: Results, wall_s: float) -> list[float]:
    """Photons a second at which all that are compared in exposures of `wall_s` have a budget."""
    lights = budgets(results.points)
    first, last = lights[0] / LEAST_LEFT, lights[-1]
    count = round(math.log10(last / first) * PER_DECADE) + 1
    fluxes: list[float] = (np.geomspace(first, last, count) / wall_s).tolist()
    return fluxes


def _groups(results: Results, measures: Measures) -> dict[str, list[Rival]]:
    """Adaptive masks of one detector by the clock, these made in no time, and known masks."""
    own = of_kind(results, "adaptive", "1x1")
    known = of_kind(results, "fixed", "1x1")
    return {"adaptive": rivals(own, measures), "free": rivals(own), "known": rivals(known)}


def _clock_claim(results: Results, measures: Measures, wall_s: float) -> Claim:
    groups, fluxes = _groups(results, measures), _fluxes(results, wall_s)
    read = {kind: [best_at(own, flux, wall_s) for flux in fluxes] for kind, own in groups.items()}
    gains = {
        flux: own - known
        for flux, own, known in zip(fluxes, read["adaptive"], read["known"], strict=True)
        if own is not None and known is not None
    }
    ahead = [flux for flux, gain in gains.items() if gain > 0]
    lost = [
        free - own
        for free, own in zip(read["free"], read["adaptive"], strict=True)
        if free is not None and own is not None
    ]
    if not gains:
        measured = "no adaptive masks leave half of the time for light"
    else:
        most = max(gains, key=lambda flux: gains[flux])
        measured = (
            f"largest gain {signed_text(gains[most])} at {_flux_text(most)} photons a second, last "
            f"one at {_flux_text(max(ahead))}; the clock takes {max(lost):.3f} at most"
            if ahead
            else "known masks are ahead at every flux"
        )
    return Claim(
        f"In exposures of {wall_s:g} s by the clock, decisions and loading included, adaptive "
        "masks read more than known masks at some flux",
        bool(ahead),
        f"{measured}; compared from {_flux_text(fluxes[0])} to {_flux_text(fluxes[-1])}",
        "interpolated between budgets; known masks are loaded before, and cost no time",
    )


def _flux_text(flux: float) -> str:
    return photons_text(float(f"{flux:.1g}"))


def _line(
    name: str, look: Look, at: Mapping[float, Point], value: Callable[[Point], float] | None = None
) -> Line:
    if value is None:
        return Line.through(name, look, at.items())
    return Line(name, look, list(at), [value(point) for point in at.values()])


def _kind_lines(
    kinds: Mapping[tuple[str, str], Chosen],
    detectors: str,
    value: Callable[[Point], float] | None = None,
) -> list[Line]:
    return [
        _line(name, look, kinds[kind, detectors], value)
        for kind, (name, look) in KINDS.items()
        if kinds[kind, detectors]
    ]


def _panels(
    kinds: Mapping[tuple[str, str], Chosen], value: Callable[[Point], float] | None = None
) -> dict[str, list[Line]]:
    """Lines against photons; of 2 × 2 detectors where there is more than one budget."""
    return {
        f"{BUDGET_AXIS}, {name}": _kind_lines(kinds, each, value)
        for each, name in DETECTORS.items()
        if each == "1x1" or len(kinds["adaptive", each]) > 1
    }


def _against_photons(kinds: Mapping[tuple[str, str], Chosen]) -> Picture:
    return Picture(
        lines_figure(_panels(kinds)),
        "Masks made for the scene in view. Accuracy against photons, at the number of looks or "
        "masks that is best on validation images. Impulse imaging has a detector for each pixel. "
        "Bars: 95 % intervals.",
        "Accuracy against photons of adaptive masks and others; numbers in the table.",
    )


def _coloured(place: int) -> Look:
    return {"color": DESIGN_COLOURS[PALETTE[place % len(PALETTE)]], "marker": "o"}


def _against_looks(results: Results, measures: Measures) -> Picture:
    points = _of_largest_prior(results)
    by_looks = {
        photons: {float(p.masks): p for p in points if p.photons == photons}
        for photons in budgets(points)
    }
    panels: dict[str, Mapping[float, Mapping[float, Point]]] = {
        "number of looks": by_looks,
        "scenes, or centres, in the prior": _by_prior(results, measures),
    }
    return Picture(
        lines_figure(
            {
                label: [
                    _line(f"{photons_text(photons)} photons", _coloured(place), at)
                    for place, (photons, at) in reversed(list(enumerate(lines.items())))
                ]
                for label, lines in panels.items()
            }
        ),
        "How many looks, and how large a prior? Accuracy of adaptive masks with one detector "
        "against the number of looks, and in one number of looks against the size of the prior. "
        "Bars: 95 % intervals.",
        "Accuracy against the number of looks and the size of the prior.",
    )


def _information(kinds: Mapping[tuple[str, str], Chosen], measures: Measures) -> Picture:
    panels = _panels(kinds, lambda point: bits(point, measures))
    return Picture(
        lines_figure(panels, "information about the class (bits, at least)"),
        "What the answers tell of the class, in bits: the entropy of the classes less the cross "
        "entropy of the probabilities that are answered. It is a lower bound of the mutual "
        f"information of class and counts. Knowing the class is {measures.entropy:.2f} bits.",
        "Bits about the class against photons; numbers in the table.",
    )


def _clock(results: Results, measures: Measures) -> Picture:
    groups = _groups(results, measures)
    looks: dict[str, tuple[str, Look]] = {
        "adaptive": ("adaptive masks", {"color": DESIGN_COLOURS["adaptive"]}),
        "free": (
            "the same, made in no time",
            {"color": DESIGN_COLOURS["adaptive"], "linestyle": ":"},
        ),
        "known": ("learned masks", {"color": DESIGN_COLOURS["deepfsi"]}),
    }
    panels = {}
    for wall in WALLS_S:
        lines = []
        for kind, (name, look) in looks.items():
            at = {
                flux: accuracy
                for flux in _fluxes(results, wall)
                if (accuracy := best_at(groups[kind], flux, wall)) is not None
            }
            if at:
                lines.append(Line(name, look, list(at), list(at.values())))
        panels[f"photons a second, exposures of {wall:g} s"] = lines
    times = ", ".join(
        f"{prior.decision_s * 1e3:.2g} ms with a prior of {prior.scenes}"
        for prior in measures.priors
        if prior.recipe.endswith("-1x1")
    )
    return Picture(
        clock_figure(panels),
        "What the clock takes. Accuracy against flux in exposures of a fixed length with one "
        f"detector. No photon is counted while a mask is made ({times}) and loaded "
        f"({measures.load_s * 1e3:.2g} ms, the shortest of the devices that load while they run); "
        f"masks that leave less than {LEAST_LEFT:g} of the time for light are left out. "
        "The number of looks is the best for each flux on validation images; accuracies are "
        "interpolated between the budgets that were measured.",
        "Accuracy against photons a second at fixed lengths of exposures.",
    )


def _table(kinds: Mapping[tuple[str, str], Chosen], measures: Measures) -> Table:
    lights = sorted({photons for at in kinds.values() for photons in at})
    rows = []
    for detectors, where in DETECTORS.items():
        for kind, (name, _) in KINDS.items():
            at = kinds[kind, detectors]
            if not at or (kind == "impulse" and detectors != "1x1"):
                continue
            rows.append(
                (
                    "one for each pixel" if kind == "impulse" else where,
                    name,
                    *(_cell(at.get(photons), measures) for photons in lights),
                )
            )
    return Table(
        "Accuracy by photons, with the number of looks or masks that is best on validation images, "
        "and bits about the class",
        ("detectors", "masks", *(f"{photons_text(photons)} photons" for photons in lights)),
        tuple(rows),
    )


def _cell(point: Point | None, measures: Measures) -> str | None:
    if point is None:
        return None
    count = "" if point.every_pixel else f" ({point.masks})"
    return f"{point.accuracy:.3f}{count}, {_bits(point, measures)}"


EXPERIMENT = Experiment(
    name="adaptive",
    title="What do masks gain that are made for the scene in view?",
    paper=OWN_PAPER,
    show=show,
    measure=measure,
)
