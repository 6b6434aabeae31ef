"""
Scanner before a network of your own
====================================

``Scanner`` turns photons per pixel into noisy features and lets gradients through. So a
convolutional network of your own and the masks before it are trained in one ordinary loop.
"""

import matplotlib.pyplot as plt
import torch
from torch import nn

import deepfsi
from deepfsi.optics.masks import LearnedMasks
from deepfsi.report.style import STYLE

torch.manual_seed(0)
plt.rcParams.update(STYLE)

# %%
# Sixteen signed masks that obey ``free-dwell`` (one device, each frame for its own time), then a
# network that treats the features as a signal of 16 samples.

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
# A loop as in any program of torch. Noise is drawn anew in every step.

optimiser = torch.optim.Adam(camera.parameters(), lr=1e-2)
losses = []
for _ in range(250):
    loss = nn.functional.cross_entropy(camera(photons), y)
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
    losses.append(loss.item())

# %%
# The test draws exact Poisson counts.

camera[0] = deepfsi.Scanner(masks, noise="poisson")
camera.eval()
unseen = deepfsi.photons_per_pixel(torch.from_numpy(digits.x_test), 1e4, brightness)
with torch.no_grad():
    right = (camera(unseen).argmax(dim=1).numpy() == digits.y_test).mean()
print(f"accuracy on {len(digits.y_test)} test pictures: {right:.3f}")

figure = plt.figure(figsize=(6.4, 3.6), layout="constrained")
left, side = figure.subfigures(1, 2, width_ratios=(1, 1))
ax = left.subplots()
ax.plot(losses, color="#0072b2")
ax.set(xlabel="step", ylabel="cross-entropy, training pictures", ylim=(0, None))
left.suptitle(f"accuracy {right:.2f} on 360 test pictures, 10⁴ photons", fontsize=9)
with torch.no_grad():
    matrix = masks().difference.numpy()
peak = abs(matrix).max()
axes = side.subplots(4, 4)
for cell, mask in zip(axes.flat, matrix, strict=True):
    image = cell.imshow(mask.reshape(8, 8), cmap="RdBu_r", vmin=-peak, vmax=peak)
    cell.set(xticks=[], yticks=[])
side.suptitle("learned masks", fontsize=9)
ticks = (-peak, 0, peak)
side.colorbar(image, ax=axes, label="share of a pixel's light", ticks=ticks, format="%.2f")
plt.show()
