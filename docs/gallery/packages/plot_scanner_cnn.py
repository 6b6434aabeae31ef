"""
Scanner before a network of your own
====================================

A convolutional network of your own and the masks before it are trained in one ordinary loop of
torch. ``Scanner`` turns photons per pixel into noisy features, and gradients pass through it.
"""

import matplotlib.pyplot as plt
import torch
from torch import nn

import deepfsi
from deepfsi.physics.laws import LearnedMasks

# %%
# Sixteen signed masks obey ``free-dwell`` (one device, each frame for its own time). The network
# after them treats the features as a signal of 16 samples.

torch.manual_seed(0)
digits = deepfsi.load_dataset("digits")
x, y = torch.from_numpy(digits.x_train), torch.from_numpy(digits.y_train)
brightness = float(x.sum(dim=1).mean())
photons = deepfsi.photons_per_pixel(x, 1e4, brightness)

masks = LearnedMasks(torch.randn(16, digits.pixels), light="free-dwell", rails="dual")
camera = nn.Sequential(
    deepfsi.Scanner(masks, noise="ml_gauss"),
    nn.BatchNorm1d(16),
    nn.Unflatten(1, (1, 16)),
    nn.Conv1d(1, 32, 5, padding=2),
    nn.GELU(),
    nn.Flatten(),
    nn.Linear(32 * 16, 10),
)

# %%
# The loop is as in any program of torch. Noise is drawn anew in every step.

optimiser = torch.optim.Adam(camera.parameters(), lr=1e-2)
losses = []
for _ in range(250):
    loss = nn.functional.cross_entropy(camera(photons), y)
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    losses.append(loss.item())

# %%
# The test draws exact Poisson counts, at 10⁴ photons.

camera[0] = deepfsi.Scanner(masks, noise="poisson")
camera.eval()
unseen = deepfsi.photons_per_pixel(torch.from_numpy(digits.x_test), 1e4, brightness)
with torch.no_grad():
    right = (camera(unseen).argmax(dim=1).numpy() == digits.y_test).mean()
print(f"accuracy on {len(digits.y_test)} test pictures: {right:.3f}")

figure = plt.figure(figsize=(4.8, 4.6), layout="constrained")
above, below = figure.subfigures(2, 1)
ax = above.subplots()
ax.plot(losses)
ax.set(xlabel="step", ylabel="cross-entropy", ylim=(0, None), title="training")
with torch.no_grad():
    matrix = masks().difference.numpy()
peak = abs(matrix).max()
axes = below.subplots(2, 8)
for cell, mask in zip(axes.flat, matrix, strict=True):
    image = cell.imshow(mask.reshape(8, 8), cmap="RdBu_r", vmin=-peak, vmax=peak)
    cell.set(xticks=[], yticks=[])
    cell.spines[:].set_visible(True)
below.suptitle("learned masks")
ticks = (-peak, 0, peak)
below.colorbar(image, ax=axes, label="share of light", ticks=ticks, format="%.2f")
plt.show()
