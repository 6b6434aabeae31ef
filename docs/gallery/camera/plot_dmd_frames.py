"""
Frames of a micromirror device
==============================

Mirrors are only ON or OFF. So each pixel of a mask is a cell of many mirrors, and its grey value is
the share of them that are ON. They are spread evenly over the cell, at every grey level.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import deepfsi
from deepfsi.camera.device import find_device
from deepfsi.lab.design_data import design_rails
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.frames import unpack

# %%
# Four non-negative masks of 8 × 8 pixels become frames of a DLP7000 with 1024 × 768 mirrors. Each
# pixel is a cell of 96 × 96 mirrors.

digits = deepfsi.load_dataset("digits")
design = deepfsi.learn(digits, photons=1e5, masks=4, training={"epochs": 20})
device = find_device("dlp7000")
with tempfile.TemporaryDirectory() as folder:
    file = design.save(Path(folder) / "design.safetensors")
    frames = Path(folder) / "frames"
    patterns = Patterns.from_rails(design_rails(file), device, 1e-3).write(frames)
    mirrors = [unpack(frame, device) for frame in Patterns.read(frames).frames()]

# %%
# Frames with all mirrors ON and all OFF come first and last; they measure the light and the dark
# counts. Between them are the frames of the masks, each counted for its share of the exposure. The
# figure shows the first mask, its frame, and one cell of the frame. White mirrors are ON.

first = patterns.manifest.mask_frames[0]
window = patterns.manifest.grid.window
figure, axes = plt.subplot_mosaic(
    [["mask", "cell"], ["frame", "frame"]],
    figsize=(4.8, 5.6),
    height_ratios=(1, 1.4),
    layout="constrained",
)
image = axes["mask"].imshow(design.matrix[0].reshape(8, 8), cmap="cividis", vmin=0)
axes["mask"].set_title("mask")
figure.colorbar(image, ax=axes["mask"], label="share of light")
top, side = window[0].start, window[1].start
cell = mirrors[first][top + 288 : top + 384, side + 192 : side + 288]
axes["cell"].imshow(cell, cmap="gray")
axes["cell"].set_title("one cell of the frame")
axes["frame"].imshow(mirrors[first], cmap="gray", interpolation="antialiased")
share = patterns.manifest.shares[0]
axes["frame"].set_title(f"frame, counted for {share:.0%} of the exposure")
for ax in axes.values():
    ax.set(xticks=[], yticks=[])
plt.show()
