"""
Dead time of a photon counter
=============================

After each photon a counter is blind for its dead time, so it loses a larger share of bright light
than of dim light. The loss follows from the counted rate, and is corrected.
"""

import matplotlib.pyplot as plt
import numpy as np

from deepfsi.camera.dead_time import DeadTime
from deepfsi.lab.virtual_detector import Detector
from deepfsi_paper.camera.gate_counts import draw

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
# Counted rates up to ``most_registered`` are corrected. At a higher rate, a dead time that is wrong
# by a tenth would make the light wrong by more than a tenth.

figure, (above, below) = plt.subplots(
    2, 1, figsize=(4.8, 5), sharex=True, height_ratios=(2, 1.5), layout="constrained"
)
kinds = ((False, "non-paralysable", "o", "C0"), (True, "paralysable", "s", "C1"))
for paralysable, name, marker, colour in kinds:
    style = {"color": colour, "linestyle": "none", "markersize": 4}
    dead = DeadTime(seconds=28.5e-9, paralysable=paralysable)
    seen = counted[paralysable]
    allowed = seen < dead.most_registered
    corrected = seen[allowed] * dead.correction(seen[allowed]).arrivals
    above.loglog(rates, seen, marker=marker, label=f"counted, {name}", **style)
    below.semilogx(rates, 100 * (seen / rates - 1), marker=marker, **style)
    error = 100 * (corrected / rates[allowed] - 1)
    below.semilogx(rates[allowed], error, marker="x", label=f"corrected, {name}", **style)
above.loglog(rates, rates, color="0.4", linestyle=":", label="every photon counted")
above.set(ylabel="counts per second")
above.legend()
below.axhline(0, color="0.4", linestyle=":")
below.set(xlabel="photons per second at the counter", ylabel="error (%)")
below.legend(loc="lower left")
plt.show()
