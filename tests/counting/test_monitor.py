"""Light of a live run: the stated chances of its tests are what they are tested at."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import poisson

from counting.recording_samples import schedule
from deepfsi.counting import checks, flux
from deepfsi.counting.checks import LightMonitor
from deepfsi.counting.flux import FALSE_ALARMS, Arrivals
from deepfsi.patterns.manifest import Brightness

SCENES, SECONDS = 20, 1e-3


def all_on(photons: int) -> LightMonitor:
    """Light after the first all-ON frame of a run of scenes of one brightness; none is dark."""
    same = Brightness(low=1, high=1, between=1, within=0)
    manifest = schedule([1000] * 4).model_copy(update={"brightness": same})
    light = LightMonitor(manifest, (0,), SCENES)
    counts = np.array([[photons], [0.0]])
    lit, faults = light.begin(Arrivals(manifest.frames[:2], counts, counts, np.full(2, SECONDS)))
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
    read = round(photons / flux.EXCESS)
    fewer = poisson.cdf(read, far / (1 + flux.HARMLESS) * read)
    more = poisson.sf(read - 1, near * (1 + flux.HARMLESS) * read)
    assert fewer == pytest.approx(chance, rel=1e-3)
    assert more == pytest.approx(chance, rel=1e-3)


@pytest.mark.parametrize("unit", [1.0, 0.05])
def test_law_the_error_of_the_background_is_in_the_test_of_levels(unit):
    """A background that changes is known from short dark frames, and is far above the light."""
    rng, passes = np.random.default_rng(7), 6
    seconds = np.tile(unit * np.array([1.0, 0.01, 1.0, 0.01]), (passes, 1))
    stray = np.repeat([1e5, 3e5], passes // 2)[:, None] / unit
    light = 5e3 / unit * np.array([1, 0, 1, 0])
    brightness = Brightness(low=0.87, high=1.14, between=1.03, within=0.05)
    alarms = 0
    for _ in range(60):
        photons = rng.poisson((stray + light) * seconds)
        places = np.arange(passes), (0, 2), (1, 3), ()
        curve = flux.LightCurve(photons, seconds, *places, "")
        background = flux.Background.of(curve, 1e-4)
        assert len(background.segments) == 2
        every = np.ones(passes, bool)
        given = {"used": every, "brightness": brightness, "chance": 1e-4}
        alarms += len(flux.Flux.of(curve, background, **given).levels) > 1
    assert alarms == 0
