"""
Compare designs on your own pictures
====================================

A comparison needs two arrays: pictures and labels. It trains each design in the same way at every
photon budget, and tests it under exact photon noise.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.report.style import DESIGN_COLOURS, DESIGN_LINES
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.run import compare

# %%
# Put your own pictures here: ``x`` of shape (n, height, width), ``y`` their labels. This example
# draws discs, squares and crosses of 12 × 12 pixels at random places.

rng = np.random.default_rng(0)
down, across = np.mgrid[:12, :12]
y = rng.choice(["cross", "disc", "square"], 1500)
x = np.full((1500, 12, 12), 0.2)
for picture, label in zip(x, y, strict=True):
    u, v = abs(down - rng.uniform(3.5, 7.5)), abs(across - rng.uniform(3.5, 7.5))
    if label == "cross":
        shape = (np.minimum(u, v) < 1) & (np.maximum(u, v) < 4)
    else:
        shape = u**2 + v**2 < 10 if label == "disc" else np.maximum(u, v) < 2.8
    picture[shape] = 0.9
data = deepfsi.from_arrays(x, y, name="shapes")

# %%
# Four designs are compared at four budgets. Learned masks and PCA have eight masks for one
# micromirror device with one detector. Raster scan has a mask for each pixel, impulse imaging a
# detector for each. A folder keeps what is trained; here it is a temporary one.

recipe = Recipe(
    designs=("impulse", "raster", "pca", "deepfsi"),
    photons=(1e2, 1e3, 1e4, 1e5),
    masks=8,
    training={"epochs": 15},
)
with tempfile.TemporaryDirectory() as folder:
    results, _ = compare(recipe, data, Path(folder), command="gallery")

# %%
# ``results.points`` has an accuracy with its interval for each design and budget. These are 95 %
# intervals over 300 test pictures, for one training each.

figure, ax = plt.subplots(figsize=(4.8, 4.2), layout="constrained")
for place, name in enumerate(recipe.designs):
    points = [point for point in results.points if point.design == name]
    photons = np.array([point.photons for point in points])
    accuracy = np.array([point.accuracy for point in points])
    low = accuracy - [point.low for point in points]
    high = [point.high for point in points] - accuracy
    ax.errorbar(
        photons * 1.04**place,  # a little apart, so that bars do not hide each other
        accuracy,
        (low, high),
        color=DESIGN_COLOURS[name],
        linestyle=DESIGN_LINES.get(name, "-"),
        marker="osD^"[place],
        capsize=3,
        label=points[0].title,
    )
ax.axhline(1 / 3, color="0.4", linestyle=":")
ax.text(1.5e5, 0.325, "guessing", ha="right", va="top")
ax.set(xscale="log", xlabel="photon budget", ylabel="accuracy", ylim=(0, 1.02))
ax.legend(loc="lower left")
plt.show()
