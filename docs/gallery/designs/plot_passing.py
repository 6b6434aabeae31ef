"""
Scenes that pass a static pattern
=================================

No modulator: an object moves past one pattern, a single detector counts photons in time bins, and a
network reads the trace. The pattern is learned together with the network. Here handwritten digits
of 8 × 8 pixels pass a binary pattern, each at a place of its own.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.report.style import STYLE

plt.rcParams.update(STYLE)
PHOTONS = 1e4
passing = deepfsi.Passing(bins=24, speed=1.5, jitter=0.5)

# %%
# A scene moves 1.5 pixels a bin, and the detector counts while it moves. Its place varies by half a
# pixel rms from one exposure to the next, in training and test. ``levels=2`` makes the pattern
# binary, as a photomask is. A random pattern is the baseline, its classifier trained alike.

digits = deepfsi.load_dataset("digits", rescale=(0, 1))
few = {"epochs": 20, "hidden": (128,)}
designs = {
    "learned": deepfsi.learn(
        digits,
        photons=PHOTONS,
        exposure=passing,
        camera={"levels": 2},
        training={**few, "mask_lr": 0.2},
    ),
    "random": deepfsi.learn(
        digits, design="random", photons=PHOTONS, exposure=passing, training=few
    ),
}
results = {name: deepfsi.evaluate(each, digits, PHOTONS)[0] for name, each in designs.items()}

# %%
# The patterns, with the accuracy on test scenes under exact photon counts. A scene enters at the
# left.

figure, axes = plt.subplots(2, 1, figsize=(7, 3), layout="constrained")
for axis, (name, design) in zip(axes, designs.items(), strict=True):
    axis.imshow(design.exposure.pattern.numpy(), cmap="gray", vmin=0, vmax=1)
    axis.set_title(f"{name}: accuracy {results[name].accuracy:.3f}")
    axis.set_xticks([])
    axis.set_yticks([])

# %%
# What the detector counts of five scenes of two classes at their mean place, with photon noise.

design = designs["learned"]
figure, axes = plt.subplots(1, 2, figsize=(7, 2.6), sharey=True, layout="constrained")
rng = np.random.default_rng(0)
rates = design.matrix @ digits.x_test.T * PHOTONS / design.summed_reflectance
for axis, kind in zip(axes, (0, 1), strict=True):
    for row in np.flatnonzero(digits.y_test == kind)[:5]:
        axis.step(np.arange(24), rng.poisson(rates[:, row]), where="mid", lw=1)
    axis.set_title(f"five scenes of the class {digits.classes[kind]}")
    axis.set_xlabel("time bin")
axes[0].set_ylabel("counts")
plt.show()
