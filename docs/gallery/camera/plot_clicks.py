"""
Few clicks
==========

A detector that clicks at most once an exposure misses every further photon. Masks that are learned
for few clicks pass few photons, those that tell most. They classify better than two other ways to
have few counts.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.report.style import DESIGN_COLOURS

PHOTONS = 300.0

# %%
# The scenes are digits on a black background, and the optics split the light among all masks
# (``column``). There are three ways to have few counts:
#
# - ``counts`` and ``photons``: the masks learn which of 300 photons to pass, so that 3, 8 or 24 of
#   60 detectors click in the mean.
# - A smaller budget, and detectors that count each photon: nearly all, as masks of ``column`` pass
#   nearly all light.
# - ``photons`` alone: the masks pass nearly all of 300 photons, and nearly every detector clicks.
#   So the number of detectors, one for each mask, sets the number of clicks.

digits = deepfsi.load_dataset("digits", rescale=(0, 1))
photon_counts = deepfsi.Camera(light="column", rails="single")
clicks = deepfsi.Camera(light="column", rails="single", noise="click")
how = deepfsi.Training(epochs=20, hidden=(64,))


def measured(budget: float, **settings) -> deepfsi.Result:
    """Test of a design at the budget of its training."""
    made = deepfsi.learn(digits, photons=budget, training=how, **settings)
    [result] = deepfsi.evaluate(made, digits, budget)
    return result


COUNTS = (3, 8, 24)
ways = {
    "clicks, learned for few: 60 masks": [
        measured(PHOTONS, counts=c, masks=60, camera=clicks) for c in COUNTS
    ],
    "smaller budget, photons counted: 60 masks": [
        measured(c, masks=60, camera=photon_counts) for c in COUNTS
    ],
    "clicks, not learned for few: 3, 8, 24, 60 masks": [
        measured(PHOTONS, masks=m, camera=clicks) for m in (*COUNTS, 60)
    ],
}

# %%
# Numbers at the points are the photons that arrive at the detectors. Masks that are learned for few
# clicks are dark in most places, so that few of 300 photons arrive. Bars are 95 % intervals over
# 360 test pictures, for one training each.

figure, ax = plt.subplots(figsize=(4.8, 4.6), layout="constrained")
colours = (DESIGN_COLOURS["deepfsi"], DESIGN_COLOURS["impulse"], "0.45")
for (name, results), colour, mark in zip(ways.items(), colours, "osD", strict=True):
    seen = [each.counts for each in results]
    share = np.array([(each.accuracy, each.low, each.high) for each in results]).T
    off = (share[0] - share[1], share[2] - share[0])
    ax.errorbar(seen, share[0], off, fmt=f"{mark}-", color=colour, capsize=3, label=name)
    for each in results:
        right = mark == "D"
        ax.annotate(
            f"{each.arriving:.0f}",
            (each.counts, each.accuracy),
            xytext=(9, -6 if each.accuracy > 0.5 else 2) if right else (-7, 3),
            textcoords="offset points",
            ha="left" if right else "right",
            color=colour,
        )
ax.axhline(0.1, color="0.4", linestyle=":")
ax.text(88, 0.085, "guessing", ha="right", va="top")
ax.set(xscale="log", xlim=(1.9, 90), ylim=(0, 1))
ax.set_xticks([3, 8, 24, 60], ["3", "8", "24", "60"])
ax.minorticks_off()
ax.set(xlabel="clicks, or photons counted, in the mean", ylabel="accuracy")
figure.legend(loc="outside upper left")
plt.show()
