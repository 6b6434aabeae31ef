"""
How much light does an accuracy need?
=====================================

Each design is trained at a few budgets, and again where its curve meets the target. The answer is
an interval of photons.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.report.style import COLOURS, LINES, STYLE
from deepfsi.sweeps.planning import photons_needed
from deepfsi.sweeps.recipe import Recipe

plt.rcParams.update(STYLE | {"text.parse_math": True})

# %%
# Three designs of ten masks on digits, with a target accuracy of 0.8, for one micromirror device
# with one detector.

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
# are the photons needed: 95 % intervals that also cover what lies between tried budgets. One
# without an upper end is drawn to the highest budget.

figure, ax = plt.subplots(figsize=(6.4, 4), layout="constrained")
for place, need in enumerate(plan["needs"]):
    name, tried = need["design"], need["tried"]
    photons = [each["photons"] for each in tried]
    accuracy = np.array([each["accuracy"] for each in tried])
    low = accuracy - [each["low"] for each in tried]
    high = [each["high"] for each in tried] - accuracy
    style = {"color": COLOURS[name], "linestyle": LINES.get(name, "-"), "marker": "osD"[place]}
    ax.errorbar(photons, accuracy, (low, high), capsize=2, label=name, **style)
    ends = need["low"] or photons[0], need["high"] or photons[-1]
    ax.plot(ends, [0.8] * 2, color=COLOURS[name], linewidth=6, alpha=0.6)
ax.axhline(plan["target"], color="0.4", linestyle=":")
ax.set(xscale="log", xlabel="photon budget of an exposure", ylabel="accuracy", ylim=(0, 1))
ax.legend(loc="lower right")
plt.show()
