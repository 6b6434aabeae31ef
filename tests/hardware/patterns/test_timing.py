"""Cost of a device in time: the clock less the gates."""

import numpy as np
import pytest
from pattern_samples import export

from deepfsi.hardware.patterns.folder import GatePlan


@pytest.mark.parametrize("exposure", [1e-3, 4e-3, 0.017])
@pytest.mark.parametrize("light", ["free-dwell", "equal-dwell"])
def test_the_cost_is_the_clock_less_what_gates_are_open(tmp_path, exposure, light):
    manifest = export(tmp_path / "p", light=light, dwell_s=5e-3).manifest
    cost = GatePlan.of(manifest, exposure).cost(manifest)
    gates = GatePlan.of(manifest, exposure)
    clock = np.zeros(round(manifest.pass_s * 1e7), dtype=bool)  # steps of 0.1 µs
    for place, opens, length in zip(manifest.shown, gates.starts_s, gates.length_s, strict=True):
        for begin in manifest.starts_s[place] + opens:
            clock[round(begin * 1e7) : round((begin + length) * 1e7)] = True
    steps = len(manifest.shown) * gates.repeats
    assert cost.total == pytest.approx(1 - clock.mean(), abs=(steps + 1) / len(clock))
    assert cost.sentinels * manifest.pass_s == pytest.approx(4 * 5e-3)
    assert cost.settling * manifest.pass_s == pytest.approx(10 * 10e-6)
    assert cost.idle >= 0
    assert GatePlan.of(manifest, exposure, repeats=1).cost(manifest).idle >= cost.idle
