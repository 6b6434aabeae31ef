"""
Dead time of a photon counter
=============================

After each photon a counter is blind for its dead time, so bright light loses a larger share of its
photons than dim light. The loss is known from the counted rate, and corrected.
"""

import matplotlib.pyplot as plt
import numpy as np

from deepfsi.hardware.recording.dead_time import DeadTime
from deepfsi.hardware.virtual.detector import Detector
from deepfsi.report.style import STYLE
from deepfsi_paper.camera.gate_counts import draw

plt.rcParams.update(STYLE | {"text.parse_math": True})

# %%
# Two counters of 28.5 ns dead time see light of 10⁵ to 10⁷·⁵ photons per second, each rate for ten
# gates of 1 ms. A *non-paralysable* counter is blind after each photon that it counts; a
# *paralysable* one also after each photon that it misses.

rates = np.geomspace(1e5, 10**7.5, 26)
gates = np.full((len(rates), 10), 1e-3)
rng = np.random.default_rng(0)
counted = {}
for paralysable in (False, True):
    counter = Detector(dead_time_s=28.5e-9, paralysable=paralysable)
    counts = draw(counter, rates[:, None], gates, rng)
    counted[paralysable] = counts.sum(axis=1) / gates.sum(axis=1)

# %%
# Rates up to ``most_registered`` are corrected. Beyond it, a dead time that is wrong by a tenth
# would make the light wrong by more than a tenth.

figure, (above, below) = plt.subplots(
    2, 1, figsize=(6.4, 5), sharex=True, height_ratios=(2, 1.3), layout="constrained"
)
for paralysable, colour in ((False, "#0072b2"), (True, "#d55e00")):
    name = "paralysable" if paralysable else "non-paralysable"
    dead = DeadTime(seconds=28.5e-9, paralysable=paralysable)
    seen = counted[paralysable]
    allowed = seen < dead.most_registered
    corrected = seen[allowed] * dead.correction(seen[allowed]).arrivals
    above.loglog(rates, seen, "o", color=colour, label=f"counted, {name}")
    below.semilogx(rates, 100 * (seen / rates - 1), "o", color=colour, label="as counted")
    error = 100 * (corrected / rates[allowed] - 1)
    below.semilogx(rates[allowed], error, "x", color=colour, label="corrected")
above.loglog(rates, rates, color="0.4", linestyle=":", label="every photon counted")
above.set(ylabel="counts per second")
above.legend()
below.axhline(0, color="0.4", linestyle=":")
below.set(xlabel="photons per second at the counter", ylabel="error, %")
below.legend(ncols=2)
plt.show()
