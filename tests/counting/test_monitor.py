"""Light of passes: what is known of the background is in the test of levels."""

import numpy as np
import pytest

from deepfsi.counting import flux
from deepfsi.patterns.manifest import Brightness


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
