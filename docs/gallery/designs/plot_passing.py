"""
Scenes that pass a static pattern
=================================

A scene that moves needs no modulator. It passes one static pattern, a single detector counts
photons in time bins, and a network classifies the counts. The pattern is learned with the network,
and classifies better than a random one.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi_flow.settings import Passing

PHOTONS = 1e4
passing = Passing(bins=24, speed=1.5, jitter=0.5)

# %%
# The scenes are handwritten digits of 8 × 8 pixels. A scene moves 1.5 pixels a bin, and the
# detector counts while it moves. Its place varies by half a pixel rms from one exposure to the
# next, in training and test. ``levels=2`` makes the pattern binary, as a photomask is. A random
# pattern is the baseline; its classifier is trained in the same way.

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
# The patterns, with the accuracy on test scenes under exact photon noise. White lets light pass. A
# scene enters at the left.

figure, axes = plt.subplots(2, 1, figsize=(4.8, 2.6), layout="constrained")
for axis, (name, design) in zip(axes, designs.items(), strict=True):
    axis.imshow(design.exposure.pattern.numpy(), cmap="gray", vmin=0, vmax=1)
    axis.set_title(f"{name}: accuracy {results[name].accuracy:.3f}")
    axis.set_xticks([])
    axis.set_yticks([])

# %%
# Counts behind the learned pattern, with photon noise, of five scenes of each of two classes. All
# scenes are at their mean place.

design = designs["learned"]
figure, axes = plt.subplots(
    2, 1, figsize=(4.8, 4.6), sharex=True, sharey=True, layout="constrained"
)
rng = np.random.default_rng(0)
rates = design.matrix @ digits.x_test.T * PHOTONS / design.summed_reflectance
for axis, kind in zip(axes, (0, 1), strict=True):
    for row in np.flatnonzero(digits.y_test == kind)[:5]:
        axis.step(np.arange(1, 25), rng.poisson(rates[:, row]), where="mid", lw=1)
    axis.set(
        title=f"five scenes of the class {digits.classes[kind]}", ylabel="counts", ylim=(0, None)
    )
axes[1].set_xlabel("time bin")
plt.show()
