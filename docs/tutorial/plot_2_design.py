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
# This command learns eight masks at 10⁴ photons. The camera is one micromirror device with one
# detector, unless you name another. Masks for it are non-negative by default; ``--rails dual``
# makes them signed.

os.system(
    "deepfsi design --data my-pictures --photons 1e4 --masks 8 --rails dual --epochs 30 "
    "-o mine.safetensors"
)

# %%
# The same in Python::
#
#     camera, training = deepfsi.Camera(rails="dual"), deepfsi.Training(epochs=30)
#     deepfsi.learn(data, camera=camera, photons=1e4, masks=8, training=training)
#
# The file holds the whole design. Python reads it:

design = deepfsi.Design.load("mine.safetensors")
print(design)

# %%
# What the command prints:
#
# - *accuracy* is the share of test pictures that are classified rightly from noisy counts.
# - ± is half of the **95 % interval** over test pictures. It says nothing about another training;
#   page 3 trains several times for that.
# - *counts* are the photons that the detector counts. They are a share of the budget, since each
#   mask is shown for a part of the time and has a part of the mirrors ON.
# - *balanced* is the mean of the classes' accuracies. The worst class is named after its
#   accuracy.

# %%
# Masks and rails
# ---------------
#
# These masks have positive and negative values, but mirrors are only ON or OFF. So each mask is
# shown as two frames, its **rails**: the positive part M⁺, then the negative part M⁻. Each gives a
# count, and the network reads the difference y = y⁺ − y⁻.
#
# In the figure each mask has its two rails below it. The value of a pixel is the share of its
# photons that is counted. Rails are drawn from black, 0, to white, the largest value of the bar.

figure, axes = plt.subplots(3, 8, figsize=(4.8, 2.1), layout="constrained")
plus, minus = design.rails.stacked.numpy()
peak = abs(design.matrix).max()
for column, signed, first, second in zip(axes.T, design.matrix, plus, minus, strict=True):
    image = column[0].imshow(signed.reshape(8, 8), cmap="RdBu_r", vmin=-peak, vmax=peak)
    column[1].imshow(first.reshape(8, 8), cmap="gray", vmin=0, vmax=peak)
    column[2].imshow(second.reshape(8, 8), cmap="gray", vmin=0, vmax=peak)
    for ax in column:
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set_visible(True)
for ax, name in zip(axes[:, 0], ("mask M", "rail M⁺", "rail M⁻"), strict=True):
    ax.set_ylabel(name)
figure.colorbar(image, ax=axes, label="share of light")
plt.show()

# %%
# One exposure
# ------------
#
# One scene sends its photons, each rail gives a Poisson count, and the network turns the counts
# into class probabilities. Here ``scanner().counts`` stands for your detector.

data = deepfsi.load_dataset("my-pictures")
scene = torch.from_numpy(data.x_test[3])
expected = deepfsi.photons_per_pixel(scene, 1e4, design.summed_reflectance)
counts = design.scanner().counts(expected, torch.Generator().manual_seed(0)).numpy()
probabilities = design.classify(counts, photons=1e4)

figure, axes = plt.subplot_mosaic(
    [["scene", "counts"], ["scene", "answer"]],
    figsize=(4.8, 3.8),
    width_ratios=(1, 2.4),
    layout="constrained",
)
axes["scene"].imshow(data.x_test[3].reshape(8, 8), cmap="gray", vmin=0, vmax=1)
axes["scene"].set(xticks=[], yticks=[], title=f"scene: a {data.classes[data.y_test[3]]}")
places = np.arange(1, 9)
axes["counts"].bar(places - 0.2, counts[0], width=0.4, color="#b2182b", label="y⁺")
axes["counts"].bar(places + 0.2, counts[1], width=0.4, color="#2166ac", label="y⁻")
axes["counts"].set(xlabel="mask", ylabel="counts", xticks=places)
axes["counts"].legend(ncols=2, loc="lower right", bbox_to_anchor=(1, 1))
axes["answer"].bar(range(10), probabilities, color="0.4")
axes["answer"].set(xlabel="class", ylabel="probability", xticks=range(10), ylim=(0, 1))
plt.show()

# %%
# The network also needs the budget: ``classify`` divides the counts by it. A real camera measures
# the budget with all mirrors ON.
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
#    rails are both bright has a noisy difference. The training takes this into account.
#
# **2.** Learn the same design without ``--rails dual``: non-negative masks, one frame each. Which
# design is better here, and why may that be?
#
# .. dropdown:: Answer
#
#    Compare the two picture by picture with ``deepfsi.base.intervals.paired_difference`` of
#    ``Result.right``. If its interval contains 0, 360 pictures do not decide. On one device a
#    single rail can be better: each frame is a feature of its own, and the network can subtract by
#    itself.
