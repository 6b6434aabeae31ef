"""
Few clicks
==========

Detectors that click at most once an exposure: which of the photons should they see? Masks that
learn for few clicks, beside two other ways to count little.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.report.style import COLOURS, STYLE

plt.rcParams.update(STYLE)
PHOTONS = 300.0

# %%
# Digits on a black background, 300 photons an exposure, and optics that split them among all masks
# (``column``). With ``counts`` and ``photons`` the masks learn which photons to pass, so that so
# many of 60 detectors click in the mean. Without ``counts`` they take nearly all the light, and
# nearly every detector clicks: only fewer detectors click less. The third way is a smaller budget
# and detectors that count each photon: ``counts`` alone finds that budget.

digits = deepfsi.load_dataset("digits", rescale=(0, 1))
photon_counts = deepfsi.Camera(light="column", rails="single")
clicks = deepfsi.Camera(light="column", rails="single", noise="click")
how = deepfsi.Training(epochs=20, hidden=(64,))


def measured(budget: float | None = None, **settings) -> deepfsi.Result:
    """Test of a design at the budget of its training."""
    made = deepfsi.learn(digits, photons=budget, training=how, **settings)
    [result] = deepfsi.evaluate(made, digits, made.info["job"]["photons"])
    return result


COUNTS = (3, 8, 24)
ways = {
    "300 photons, clicks, learned for few: 60 masks": [
        measured(PHOTONS, counts=c, masks=60, camera=clicks) for c in COUNTS
    ],
    "a smaller budget, each photon counted: 60 masks": [
        measured(counts=c, masks=60, camera=photon_counts) for c in COUNTS
    ],
    "300 photons, clicks, not learned for few: 3, 8, 24 and 60 masks": [
        measured(PHOTONS, masks=m, camera=clicks) for m in (*COUNTS, 60)
    ],
}

# %%
# Against what is detected, with the photons that arrive at the detectors beside each point. Learned
# for few clicks, the masks are dark in most places, so that of 300 photons few arrive, and those
# that tell most.

figure, ax = plt.subplots(figsize=(6.4, 4.6), layout="constrained")
colours = (COLOURS["deepfsi"], COLOURS["impulse"], "0.45")
for (name, results), colour, mark in zip(ways.items(), colours, "osD", strict=True):
    seen = [each.counts for each in results]
    share = np.array([(each.accuracy, each.low, each.high) for each in results]).T
    off = (share[0] - share[1], share[2] - share[0])
    ax.errorbar(seen, share[0], off, fmt=f"{mark}-", color=colour, capsize=3, label=name)
    for each in results:
        side = (
            {"ha": "left", "xytext": (7, 3)} if mark == "D" else {"ha": "right", "xytext": (-7, 3)}
        )
        place = (each.counts, each.accuracy)
        ax.annotate(f"{each.arriving:.0f}", place, textcoords="offset points", color=colour, **side)
ax.axhline(0.1, color="0.4", linestyle=":")
ax.text(78, 0.085, "guessing", ha="right", va="top")
ax.set(xscale="log", xlim=(2.3, 80), ylim=(0, 1))
ax.set_xticks([3, 8, 24, 60], ["3", "8", "24", "60"])
ax.minorticks_off()
ax.set(xlabel="clicks, or photons counted, in the mean", ylabel="accuracy")
figure.legend(loc="outside upper left", fontsize=9, frameon=False)
figure.supxlabel(
    "numbers: photons that arrive; 95 % intervals over 360 test pictures, one training each",
    fontsize=9,
)
plt.show()
