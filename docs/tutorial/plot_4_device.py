"""
4. Onto a micromirror device
============================

The masks become frames of a real device, with a time for each. A virtual camera shows them and
writes a photon file; the same commands then read the file of your own camera.
"""

import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from deepfsi.hardware.patterns.folder import read_frames, read_patterns
from deepfsi.hardware.patterns.mirrors import unpack
from deepfsi.hardware.recording.counts import read_counts

# %%
# Your camera
# -----------
#
# You describe your camera once, in a file, in its own units. This one has a DLP7000 of 1024 × 768
# mirrors and one detector, which counts 10⁷ photons per second when all mirrors are ON. In an
# exposure of 1 ms that is a budget of 10⁴ photons. The detector is blind for 28.5 ns after each
# count.

Path("my-lab.toml").write_text("""\
light = "free-dwell"    # one device, one detector
device = "dlp7000"
exposure = "1ms"
flux = 1e7              # counts/s, all mirrors of the region ON
dead_time = "28.5ns"
""")

# %%
# What the file does not say follows from the rest. ``camera describe`` says what the camera can
# show, and ``design`` learns masks for it:

os.system("deepfsi camera describe my-lab.toml")
os.system(
    "deepfsi design --camera my-lab.toml --data my-pictures --masks 8 --epochs 30 "
    "-o for-my-lab.safetensors"
)

# %%
# The design file keeps the camera, so the commands that follow need no file.
#
# Frames
# ------
#
# The masks become frames of the device, with picture times in which an exposure has room.

os.system("deepfsi dmd export for-my-lab.safetensors -o frames")

# %%
# Frames with all mirrors ON and all OFF come first and last. They tell the light and the dark
# counts of every exposure. *Cost in time* says what share of the clock counts no photons.
#
# The light law is now a timetable: each frame is counted for its **share** of the exposure,
# and the shares sum to 1.

patterns = read_patterns("frames")
manifest = patterns.manifest
frames = [unpack(frame, manifest.device) for frame in read_frames("frames")]
figure, axes = plt.subplots(2, 4, figsize=(6.4, 3.6), layout="constrained")
for ax, place, share in zip(axes.flat, manifest.shown, manifest.shares, strict=True):
    ax.imshow(frames[place], cmap="gray", interpolation="antialiased")
    ax.set(xticks=[], yticks=[], xlabel=f"{share:.1%} of the time")
figure.suptitle("frames of the eight masks: white mirrors are ON", fontsize=9)
plt.show()

# %%
# A recording
# -----------
#
# Two test pictures of each class are put before a virtual camera with the light and the dead time
# of the file.

os.system("deepfsi data export my-pictures --per-class 2 -o scenes")
os.system("deepfsi camera simulate frames --scene scenes --repeats 1 -o run_0001")

# %%
# In the laboratory, ``deepfsi camera prepare`` makes the folder instead, and your counter's own
# ``photons.ptu`` is put into it. From here on everything is the same.

os.system("deepfsi camera count run_0001")
os.system("deepfsi camera classify for-my-lab.safetensors run_0001")

# %%
# ``classify`` names scenes whose counts do not look like those of the training: stray light, a
# wrong mask order or another kind of scene show there, before you trust a class.
#
# The counts of one scene of each of three classes, with their standard deviations:

counts = read_counts("run_0001")
signal, spread = counts.signal()[:, 0, 0], np.sqrt(counts.variance[:, 0, 0])
figure, ax = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
for number, (scene, marker, colour) in enumerate(
    zip((0, 2, 14), "os^", ("#0072b2", "#d55e00", "#009e73"), strict=True)
):
    at = np.arange(1, 9) + 0.12 * (number - 1)
    style = {"color": colour, "linestyle": "none", "marker": marker, "capsize": 2}
    ax.errorbar(at, signal[scene], spread[scene], label=f"a {scene // 2}", **style)
ax.set(xlabel="mask", ylabel="counts in 1 ms", xticks=range(1, 9), ylim=(0, 750))
ax.legend(title="scene", ncols=3, loc="upper center")
plt.show()

# %%
# Exercises
# ---------
#
# **1.** The device shows no frame shorter than 44 µs. Does that limit an exposure of 1 ms?
#
# .. dropdown:: Answer
#
#    Not with eight frames. A frame is counted for 44 µs less 10 µs, in which the mirrors settle,
#    and 2 µs of margin: for 32 µs at least. So the exposure has room for 31 frames. The training
#    knows it from the camera, and gives no frame less.
#
# **2.** Your detector has an efficiency of 0.25, and 10⁵ photons reach the device. Which budget
# does the classifier get?
#
# .. dropdown:: Answer
#
#    2.5 · 10⁴. For the counts a photon that is not detected is the same as one that never came, so
#    the camera works as an ideal one with the budget times the efficiency. ``camera count`` finds
#    the budget from the all-ON frames, efficiency included.
#
# **3.** Count the recording with ``--dead-time 0``. Which frames lose most?
#
# .. dropdown:: Answer
#
#    The brightest ones, the all-ON frames above all. The budget is then estimated too low, and the
#    masks' counts look too large beside it.
