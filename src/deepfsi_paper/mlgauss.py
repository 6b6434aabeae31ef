"""Cost in accuracy of the MLGauss approximation of photon noise, for each design."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from deepfsi.base.intervals import Difference, all_above
from deepfsi.report.style import photons_text
from deepfsi.sweeps.results import Point, Results, accuracy_difference
from deepfsi_paper.experiment import Experiment, Finding, points
from deepfsi_paper.report.maps import Pair, difference_figure, pair
from deepfsi_paper.report.section import Claim, Picture, Table

NOTICED = 0.02
"""Difference in accuracy that is noticed."""

STARVED = 0.1
"""Photons per pixel and measurement, Φ / (N m)."""

MANY = 10.0
"""Photons above which the paper takes MLGauss for valid in the estimate of gradients."""

TESTS = ("tested with MLGauss", "tested with Poisson")

PAPER = (
    "DeepFSI is trained with MLGauss and tested with MLGauss and with exact Poisson noise. "
    "Discrepancies arise mainly below 0.1 photons per pixel per measurement, where accuracy is low "
    "in any case; elsewhere MLGauss is a reasonable approximation. Other designs may do the same, "
    "and raster scan may be affected more, as each of its readouts counts one pixel alone: the "
    "paper leaves them open. Gradients of MLGauss are valid above 10 photons."
)

Places = Mapping[tuple[float, float], Difference]
"""Poisson less MLGauss by (ratio, photons)."""


@dataclass(frozen=True)
class Compared:
    """One design under both tests."""

    label: str
    pixels: int
    pair: Pair

    @property
    def large(self) -> Places:
        """Differences that are noticed."""
        return {
            place: each for place, each in self.pair.differences.items() if abs(each.mean) > NOTICED
        }

    @property
    def lit(self) -> Places:
        """Differences in light that is not starved."""
        return {
            (ratio, photons): each
            for (ratio, photons), each in self.pair.differences.items()
            if photons / (self.pixels * ratio * self.pixels) >= STARVED
        }

    @property
    def claim(self) -> Claim:
        """Claim that no difference is noticed but in starved light."""
        bright = self.large.keys() & self.lit.keys()
        most, where = self.pair.largest
        said = (
            f"largest: {most} at {where}; {len(self.large)} above {NOTICED}, {len(bright)} of them "
            "brighter"
        )
        if self.lit:
            ratio, photons = max(self.lit, key=lambda place: _reach(self.lit[place]))
            said += (
                "; in brighter light the interval that reaches furthest is "
                f"{self.lit[(ratio, photons)]} at {ratio:.0%} and {photons_text(photons)} photons"
            )
        return Claim(
            f"{self.label}: differences above {NOTICED} arise only below {STARVED} photons per "
            "pixel per measurement",
            _within(self.lit.values()),
            said,
        )

    @property
    def row(self) -> tuple[str, int, str, str, int, int]:
        """Of the table of designs."""
        most, where = self.pair.largest
        bright = self.large.keys() & self.lit.keys()
        count = len(self.pair.differences)
        return self.label, count, str(most), where, len(self.large), len(bright)


def show(results: Results) -> Finding:
    """Heat maps of both tests and of their difference, and a table of all designs."""
    tested = [point for point in results.points if point.recipe != "exact"]
    compared = {
        design: _compared(point for point in tested if point.design == design)
        for design in dict.fromkeys(point.design for point in tested)
    }
    claims = [each.claim for each in compared.values()]
    claims += _gradients(points(results, recipe="exact"))
    largest = max(compared.values(), key=lambda each: abs(each.pair.largest[0].mean))
    most, where = largest.pair.largest
    every = sum(len(each.pair.differences) for each in compared.values())
    large = sum(len(each.large) for each in compared.values())
    bright = sum(len(each.large.keys() & each.lit.keys()) for each in compared.values())
    found = (
        f"Exact Poisson less MLGauss test: {most} at most, {largest.label} at {where}. "
        f"{large} of {every} points differ by more than {NOTICED}, {large - bright} of them below "
        f"{STARVED} photons per pixel per measurement. "
        "The same trained designs are read in both tests."
    )
    table = Table(
        f"Accuracy under exact Poisson noise less that under MLGauss; points beyond {NOTICED}, and "
        f"those of them that have {STARVED} photons per pixel and measurement or more",
        ("design", "points", "largest difference", "where", "beyond", "brighter"),
        tuple(each.row for each in compared.values()),
    )
    return Finding(found, _pictures(compared.values()), tuple(claims), (table,))


def _gradients(own: Iterable[Point]) -> list[Claim]:
    """Claim that training on MLGauss costs nothing where readouts have many photons."""
    lit = [p for p in own if p.counts > MANY * p.masks * (2 if p.rails == "dual" else 1)]
    exact = {(p.ratio, p.photons): p for p in lit if p.trained_under == "poisson"}
    losses = {
        place: accuracy_difference(p, exact[place])
        for p in lit
        if p.trained_under == "ml_gauss" and (place := (p.ratio, p.photons)) in exact
    }
    if not losses:
        return []
    ratio, photons = least = min(losses, key=lambda place: losses[place].low)
    return [
        Claim(
            f"Above {MANY:g} photons a readout masks that train on MLGauss lose less than "
            f"{NOTICED} to those that train on exact counts",
            all_above(losses.values(), -NOTICED),
            f"lowest of {len(losses)}: {losses[least]} at {ratio:.0%} and {photons_text(photons)} "
            "photons",
        )
    ]


def _compared(own: Iterable[Point]) -> Compared:
    every = list(own)
    tests = ([p for p in every if p.noise == noise] for noise in ("ml_gauss", "poisson"))
    pixels = round(every[0].masks / every[0].ratio)
    return Compared(every[0].label, pixels, pair(*tests))


def _pictures(compared: Iterable[Compared]) -> tuple[Picture, ...]:
    """A map of each design with several ratios; of those with one the table has the numbers."""
    return tuple(
        Picture(
            difference_figure(each.pair, TESTS),
            f"{each.label}: accuracy by budget and compression ratio, trained with MLGauss.",
            "Heat maps of accuracy under two test noises, and of their difference.",
        )
        for each in compared
        if len(each.pair.ratios) > 1
    )


def _reach(each: Difference) -> float:
    """Farthest end of an interval from 0."""
    return max(each.high, -each.low)


def _within(differences: Iterable[Difference]) -> bool | None:
    """Test that no difference is beyond what is noticed, either way."""
    return all_above([part for each in differences for part in (each, -each)], -NOTICED)


EXPERIMENT = Experiment(name="mlgauss", title="What MLGauss leaves out", paper=PAPER, show=show)
