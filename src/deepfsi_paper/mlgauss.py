"""Cost in accuracy of the MLGauss approximation of photon noise."""

from collections.abc import Iterable

from deepfsi.report.style import photons_text
from deepfsi.statistics.differences import Difference, above
from deepfsi.sweeps.results import Results
from deepfsi_paper.experiment import Experiment, Finding, points
from deepfsi_paper.paired_maps import pair
from deepfsi_paper.report.section import Claim, Picture

NOTICED = 0.02
"""Difference in accuracy that is noticed."""

STARVED = 0.1
"""Photons per pixel and measurement, Φ / (N m)."""

PAPER = (
    "DeepFSI is trained with MLGauss and tested with MLGauss and with exact Poisson noise. "
    "Discrepancies arise mainly below 0.1 photons per pixel per measurement, where accuracy is low "
    "in any case; elsewhere MLGauss is a reasonable approximation."
)


def show(results: Results) -> Finding:
    """Contour maps of both tests and of their difference."""
    both = pair(*(points(results, noise=noise) for noise in ("ml_gauss", "poisson")))
    pixels = round(results.points[0].masks / results.points[0].ratio)
    large = {place: each for place, each in both.differences.items() if abs(each.mean) > NOTICED}
    lit = {
        place: each
        for place, each in both.differences.items()
        if place[1] / (pixels * place[0] * pixels) >= STARVED
    }
    bright = large.keys() & lit.keys()
    most, where = both.largest
    said = (
        f"largest: {most} at {where}; {len(large)} above {NOTICED}, {len(bright)} of them brighter"
    )
    if lit:
        ratio, photons = max(lit, key=lambda place: max(lit[place].high, -lit[place].low))
        said += f"; in brighter light the interval that reaches furthest is {lit[(ratio, photons)]}"
        said += f" at {ratio:.0%} and {photons_text(photons)} photons"
    claim = Claim(
        f"Differences above {NOTICED} arise only below {STARVED} photons per pixel per measurement",
        _within(lit.values()),
        said,
    )
    found = (
        f"Exact Poisson less MLGauss test: {most} at most, at {where}. "
        f"{len(large)} of {len(both.differences)} points differ by more than {NOTICED}, "
        f"{len(large) - len(bright)} of them below {STARVED} photons per pixel per measurement. "
        "The same trained designs are read in both tests."
    )
    picture = Picture(
        both.figure(("tested with MLGauss", "tested with Poisson"), pixels),
        "Accuracy by budget and compression ratio, trained with MLGauss.",
        "Contour maps of accuracy under two test noises, and of their difference.",
    )
    return Finding(found, (picture,), (claim,))


def _within(differences: Iterable[Difference]) -> bool | None:
    """Test that no difference is beyond what is noticed, either way."""
    return above([part for each in differences for part in (each, -each)], -NOTICED)


EXPERIMENT = Experiment(name="mlgauss", title="What MLGauss leaves out", paper=PAPER, show=show)
