"""
Frames of a micromirror device
==============================

Mirrors are ON or OFF, so a grey value of a mask is the share of a cell's mirrors that are ON. They
are spread evenly over the cell, at every grey level.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import deepfsi
from deepfsi.devices import find_device
from deepfsi.hardware.patterns.folder import export_patterns, read_frames
from deepfsi.hardware.patterns.mirrors import unpack
from deepfsi.hardware.patterns.sequence import FrameSettings
from deepfsi.laboratory.rails import design_rails
from deepfsi.report.style import STYLE

plt.rcParams.update(STYLE)

# %%
# Four non-negative masks of 8 × 8 pixels, as frames of a DLP7000 with 1024 × 768 mirrors: each
# pixel of a mask is a cell of 96 × 96 mirrors.

digits = deepfsi.load_dataset("digits")
design = deepfsi.learn(digits, photons=1e5, masks=4, training={"epochs": 20})
device = find_device("dlp7000")
with tempfile.TemporaryDirectory() as folder:
    file = design.save(Path(folder) / "design.safetensors")
    frames = Path(folder) / "frames"
    patterns = export_patterns(design_rails(file), FrameSettings(device, 1e-3), frames)
    mirrors = [unpack(frame, device) for frame in read_frames(frames)]

# %%
# All mirrors ON and all OFF come first and last; they tell the light and the dark counts. Between
# them are the masks' frames, each counted for its share of the exposure.

first = patterns.manifest.shown[0]
window = patterns.manifest.grid.window
figure, (left, middle, right) = plt.subplots(1, 3, figsize=(6.4, 3.4), layout="constrained")
image = left.imshow(design.matrix[0].reshape(8, 8), cmap="cividis", vmin=0)
left.set_title("mask")
figure.colorbar(image, ax=left, location="bottom", label="share of a pixel's light")
middle.imshow(mirrors[first], cmap="gray", interpolation="antialiased")
middle.set_title("its frame on the device")
middle.set_xlabel(f"shown for {patterns.manifest.shares[0]:.0%} of the exposure")
top, side = window[0].start, window[1].start
right.imshow(mirrors[first][top + 240 : top + 336, side + 240 : side + 336], cmap="gray")
right.set_title("96 × 96 of its mirrors")
right.set_xlabel("white: ON")
for ax in (left, middle, right):
    ax.set(xticks=[], yticks=[])
plt.show()
