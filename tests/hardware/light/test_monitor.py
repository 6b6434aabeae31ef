"""Light of a live run: the stated chances of its tests are what they are tested at."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import poisson

from deepfsi.hardware.light import checks, curves, flux
from deepfsi.hardware.light.checks import LightMonitor
from deepfsi.hardware.light.curves import FALSE_ALARMS, PARTS_OF_FRAME, Arrivals
from deepfsi.hardware.patterns.manifest import Brightness
from hardware.counting.recording_samples import schedule

SCENES, SECONDS = 20, 1e-3


def all_on(photons: int) -> LightMonitor:
    """Light after the first all-ON frame of a run of scenes of one brightness; none is dark."""
    same = Brightness(low=1, high=1, between=1, within=0)
    manifest = schedule([1000] * 4).model_copy(update={"brightness": same})
    light = LightMonitor(manifest, (0,), SCENES)
    parts = np.full((2, PARTS_OF_FRAME), SECONDS / PARTS_OF_FRAME)
    counts = np.zeros((2, PARTS_OF_FRAME, 1))
    counts[0] = photons / PARTS_OF_FRAME
    lit, faults = light.begin(Arrivals(manifest.frames[:2], counts, counts, parts))
    assert lit
    assert not faults
    return light


@pytest.mark.parametrize("photons", [110, 11_000])
def test_law_a_stated_flux_is_contradicted_at_the_stated_chance(photons):
    """Half of it on each side, of counts with `EXCESS` times the variance of Poisson's."""
    light, each = all_on(photons), photons / SECONDS

    def edge(low: float, high: float) -> float:
        return brentq(lambda s: light.contradicts(s * each) - 0.5, low, high, xtol=1e-9)

    chance = FALSE_ALARMS / checks.CHECKS / SCENES / 2
    far, near = edge(1.0, 5.0), edge(0.1, 1.0)
    read = round(photons / curves.EXCESS)
    fewer = poisson.cdf(read, far / (1 + flux.HARMLESS) * read)
    more = poisson.sf(read - 1, near * (1 + flux.HARMLESS) * read)
    assert fewer == pytest.approx(chance, rel=1e-3)
    assert more == pytest.approx(chance, rel=1e-3)
