"""
Pictures by deepinv
===================

A design's optics are a linear measurement with photon noise, which deepinv reconstructs pictures
from. This script needs ``pip install deepinv``; a site built without it shows no figure here.
"""

import matplotlib.pyplot as plt
import torch
from deepinv.physics import LinearPhysics

import deepfsi
from deepfsi.report.style import STYLE, photons_text

plt.rcParams.update(STYLE)

# %%
# An adapter of three methods: pictures in photons per pixel to counts, and back.


class SinglePixelCamera(LinearPhysics):
    """Pictures (batch, 1, H, W) to counts (batch, rails, masks) of a design, with noise."""

    def __init__(self, design, generator=None):
        super().__init__(img_size=(1, *design.image_shape))
        self.scanner, self.generator = design.scanner(), generator
        self.register_buffer("rails", design.rails.stacked.flatten(0, 1))
        self.shape = design.rails.stacked.shape[:2]

    def A(self, x, **kwargs):
        return (x.flatten(1) @ self.rails.T).unflatten(1, self.shape)

    def A_adjoint(self, y, **kwargs):
        return (y.flatten(1) @ self.rails).unflatten(1, self.img_size)

    def noise(self, x, **kwargs):
        return self.scanner.read(x, self.generator)


# %%
# Thirty-two learned masks of the paper's optics; the pseudo-inverse is deepinv's. Its networks take
# the same camera. At 10⁴ photons hardly a picture is left, and the classes are still read from the
# same counts.

digits = deepfsi.load_dataset("digits")
scenes = torch.from_numpy(digits.x_test[:6])
figure, axes = plt.subplots(3, 6, figsize=(6.4, 3.8), layout="constrained")
budgets = (1e4, 1e6)
design = deepfsi.learn(digits, camera="paper", photons=1e6, masks=32, training={"epochs": 20})
camera = SinglePixelCamera(design, torch.Generator().manual_seed(0))
for ax, scene in zip(axes[0], scenes, strict=True):
    ax.imshow(scene.reshape(8, 8), cmap="gray", vmin=0, vmax=1)
for row, photons in zip(axes[1:], budgets, strict=True):
    expected = deepfsi.photons_per_pixel(scenes, photons, design.summed_reflectance)
    counts = camera(expected.reshape(-1, 1, 8, 8))
    classes = design.classify(counts, photons).argmax(axis=-1)
    pictures = camera.A_dagger(counts) * design.summed_reflectance / photons
    for ax, picture, found in zip(row, pictures, classes, strict=True):
        ax.imshow(picture[0], cmap="gray", vmin=0, vmax=1)
        ax.set_xlabel(f"read as {digits.classes[found]}")
for ax in axes.flat:
    ax.set(xticks=[], yticks=[])
axes[0, 0].set_ylabel("scene")
for row, photons in zip(axes[1:], budgets, strict=True):
    row[0].set_ylabel(f"{photons_text(photons)} photons")
plt.show()

# sphinx_gallery_thumbnail_path = 'figures/deepinv.png'
