"""
2. Masks, rails and a network
=============================

A **design** is a set of masks and the network that reads their counts, trained together for a
photon budget. This page learns one, and follows one exposure from the scene to its class.
"""

import os

import matplotlib.pyplot as plt
import numpy as np
import torch

import deepfsi

# %%
# Learn a design
# --------------
#
# Eight signed masks at 10⁴ photons, for one micromirror device and one detector. That is the camera
# unless you say otherwise; its masks are then non-negative, and ``--rails dual`` makes them signed.
# On the command line it is

os.system(
    "deepfsi design --data my-pictures --photons 1e4 --masks 8 --rails dual --epochs 30 "
    "-o mine.safetensors"
)

# %%
# and in Python::
#
#     camera, training = deepfsi.Camera(rails="dual"), deepfsi.Training(epochs=30)
#     deepfsi.learn(data, camera=camera, photons=1e4, masks=8, training=training)
#
# The file holds everything; Python reads it with

design = deepfsi.Design.load("mine.safetensors")
print(design)

# %%
# Read the output line by line. *Test accuracy* is the share of test pictures that are classified
# rightly from noisy counts. ± is half of the **95 % interval**: if you repeated the test with other
# pictures of the same kind, intervals made in this way would hold the true accuracy in 95 of 100
# repetitions. It says nothing about another training; page 3 trains several times for that.
# *Counts* are the photons that the detector counts, here a fraction of the budget, since a mask is
# shown for a part of the time and opens a part of the mirrors.

# %%
# Masks and rails
# ---------------
#
# A mask has positive and negative values, but mirrors are only ON or OFF. So each mask is shown as
# two frames, its **rails**: the positive part M⁺, then the negative part M⁻. Each gives a count,
# and the network reads the difference y = y⁺ − y⁻. The value of a pixel is the share of its
# photons that is counted.

figure, axes = plt.subplots(3, 8, figsize=(6.4, 2.9), layout="constrained")
plus, minus = design.rails.stacked.numpy()
peak = abs(design.matrix).max()
for column, signed, first, second in zip(axes.T, design.matrix, plus, minus, strict=True):
    image = column[0].imshow(signed.reshape(8, 8), cmap="RdBu_r", vmin=-peak, vmax=peak)
    column[1].imshow(first.reshape(8, 8), cmap="gray", vmin=0, vmax=peak)
    column[2].imshow(second.reshape(8, 8), cmap="gray", vmin=0, vmax=peak)
    for ax in column:
        ax.set(xticks=[], yticks=[])
for ax, name in zip(axes[:, 0], ("mask M", "rail M⁺", "rail M⁻"), strict=True):
    ax.set_ylabel(name)
figure.colorbar(image, ax=axes, label="share of a pixel's light")
plt.show()

# %%
# One exposure
# ------------
#
# The scene's photons, the Poisson counts behind each rail, and the class probabilities that the
# network gives. ``scanner().counts`` stands for your detector.

data = deepfsi.load_dataset("my-pictures")
scene = torch.from_numpy(data.x_test[3])
expected = deepfsi.photons_per_pixel(scene, 1e4, design.summed_reflectance)
counts = design.scanner().counts(expected, torch.Generator().manual_seed(0)).numpy()
probabilities = design.classify(counts, photons=1e4)

figure, (left, middle, right) = plt.subplots(
    1, 3, figsize=(6.4, 2.8), width_ratios=(1, 1.6, 1.6), layout="constrained"
)
left.imshow(data.x_test[3].reshape(8, 8), cmap="gray", vmin=0, vmax=1)
left.set(xticks=[], yticks=[], title=f"scene: a {data.classes[data.y_test[3]]}")
places = np.arange(1, 9)
middle.bar(places - 0.2, counts[0], width=0.4, color="#b2182b", label="y⁺")
middle.bar(places + 0.2, counts[1], width=0.4, color="#2166ac", label="y⁻")
middle.set(xlabel="mask", ylabel="counts", xticks=places)
middle.legend()
right.bar(range(10), probabilities, color="#5d6670")
right.set(xlabel="class", ylabel="probability", xticks=range(10), ylim=(0, 1))
plt.show()

# %%
# The network is given the budget as well: ``classify`` divides the counts by it. On a real camera
# an all-ON frame tells the budget.
#
# Exercises
# ---------
#
# **1.** The two rails of mask 1 count 200 and 150 photons. What is the feature y, and what is its
# standard deviation?
#
# .. dropdown:: Answer
#
#    y = 50. Poisson variances add, also in a difference: √(200 + 150), about 19. So a mask whose
#    rails are both bright has a noisy difference, which the training takes into account.
#
# **2.** Learn the same design without ``--rails dual``: non-negative masks, one frame each. Which
# is better here, and why may it be?
#
# .. dropdown:: Answer
#
#    Here the intervals overlap, and 360 pictures do not tell. On one device a single rail can be
#    better: each of its frames is a feature of its own, and the network can do any subtraction
#    itself, where a dual-rail mask spends two frames on one number.
