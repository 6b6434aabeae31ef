"""
How much light does an accuracy need?
=====================================

``photons_needed`` answers with an interval of photons for each design. It trains each at a few
budgets, and again near the budget at which the accuracy meets the target.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.report.style import DESIGN_COLOURS, DESIGN_LINES
from deepfsi.sweeps.forecast import photons_needed
from deepfsi.sweeps.recipe import Recipe

# %%
# Three designs of ten masks are planned for digits and one micromirror device with one detector.
# The target is an accuracy of 0.8.

digits = deepfsi.load_dataset("digits")
recipe = Recipe(
    designs=("truncated-hadamard", "pca", "deepfsi"),
    photons=(1e2, 1e3, 1e4, 1e5),
    masks=10,
    training={"epochs": 15},
)
with tempfile.TemporaryDirectory() as folder:
    plan, _ = photons_needed(recipe, digits, 0.8, Path(folder), command="gallery")

# %%
# Dots are trained designs, with 95 % intervals over the 360 test pictures. Thick bars at the target
# are the photons needed: 95 % intervals that also cover what lies between the tried budgets. A bar
# without an upper end is drawn to the highest budget.

figure, ax = plt.subplots(layout="constrained")
for place, need in enumerate(plan["needs"]):
    name, tried = need["design"], need["tried"]
    photons = [each["photons"] for each in tried]
    accuracy = np.array([each["accuracy"] for each in tried])
    low = accuracy - [each["low"] for each in tried]
    high = [each["high"] for each in tried] - accuracy
    style = {"color": DESIGN_COLOURS[name], "linestyle": DESIGN_LINES.get(name, "-")}
    style["marker"] = "osD"[place]
    ax.errorbar(photons, accuracy, (low, high), capsize=2, label=need["title"], **style)
    ends = need["low"] or photons[0], need["high"] or photons[-1]
    height = plan["target"] + 0.025 * (place - 1)  # a little apart, to be seen
    ax.plot(ends, [height] * 2, color=DESIGN_COLOURS[name], linewidth=5, alpha=0.6)
ax.axhline(plan["target"], color="0.4", linestyle=":")
ax.set(xscale="log", xlabel="photon budget", ylabel="accuracy", ylim=(0, 1))
ax.legend(loc="lower right")
plt.show()
