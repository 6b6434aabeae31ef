"""Cost in accuracy of the MLGauss approximation of photon noise."""

from collections.abc import Iterable

from deepfsi.experiments.experiment import Experiment, Finding, points
from deepfsi.experiments.paired_maps import pair
from deepfsi.report.section import Claim, Picture
from deepfsi.report.style import photons_text
from deepfsi.statistics.differences import Difference
from deepfsi.sweeps.results import Results

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
    bright = {
        place: each
        for place, each in large.items()
        if place[1] / (pixels * place[0] * pixels) >= STARVED
    }
    most, where = both.largest
    said = f"largest: {most} at {where}; {len(large)} above {NOTICED}"
    if bright:
        (ratio, photons), each = max(bright.items(), key=lambda item: abs(item[1].mean))
        said += f", {len(bright)} of them in brighter light: {each} at {ratio:.0%}, "
        said += f"{photons_text(photons)} photons"
    claim = Claim(
        f"Differences above {NOTICED} arise only below {STARVED} photons per pixel per measurement",
        _only_starved(bright.values()),
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


def _only_starved(bright: Iterable[Difference]) -> bool | None:
    """No if a difference in bright light is clearly beyond what is noticed, open if perhaps."""
    every = list(bright)
    if any(each.low > NOTICED or each.high < -NOTICED for each in every):
        return False
    return None if every else True


EXPERIMENT = Experiment(name="mlgauss", title="What MLGauss leaves out", paper=PAPER, show=show)
