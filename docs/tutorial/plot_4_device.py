"""
4. Onto a micromirror device
============================

At the end of this page the masks are frames for a micromirror device, and a photon file has become
classes. A virtual camera writes the photon file here; the same commands read the file of your own
camera.
"""

import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from deepfsi.counting.recording import Recording
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.frames import unpack

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
# What the file does not say follows from it or has a default. ``camera describe`` prints what the
# camera can show, and ``design`` learns masks for it:

os.system("deepfsi camera describe my-lab.toml")
os.system(
    "deepfsi design --camera my-lab.toml --data my-pictures --masks 8 --epochs 30 "
    "-o for-my-lab.safetensors"
)

# %%
# The design file contains the camera, so the commands that follow do not name it.
#
# Frames
# ------
#
# ``dmd export`` writes the masks as frames of the device, with a picture time for each.

os.system("deepfsi dmd export for-my-lab.safetensors -o frames")

# %%
# Frames with all mirrors ON and all OFF come first and last. They measure the light and the dark
# counts of every exposure. *Cost in time* is the share of the time in which no photons are counted.
#
# The light law has become times: each frame is counted for its **share** of the exposure, and the
# shares sum to 1. The figure shows the frames of the eight masks with their shares; white mirrors
# are ON.

patterns = Patterns.read("frames")
manifest = patterns.manifest
frames = [unpack(frame, manifest.device) for frame in Patterns.read("frames").frames()]
figure, axes = plt.subplots(2, 4, figsize=(4.8, 2.4), layout="constrained")
for ax, place, share in zip(axes.flat, manifest.mask_frames, manifest.shares, strict=True):
    ax.imshow(frames[place], cmap="gray", interpolation="antialiased")
    ax.set(xticks=[], yticks=[], xlabel=f"{share:.1%}")
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
# In the laboratory, ``deepfsi camera import`` makes the folder ``run_0001`` of your counter's file
# instead. The next commands are the same for both.

os.system("deepfsi camera count run_0001")
os.system("deepfsi camera classify for-my-lab.safetensors run_0001")

# %%
# A *remark* would name scenes whose counts do not look like those of the training. The cause may be
# stray light, masks in a wrong order, or another kind of scene.
#
# The figure shows the counts of one scene of each of three classes, with their standard deviations.

counts = Recording.read("run_0001").read_counts()
signal, spread = counts.signal()[:, 0, 0], np.sqrt(counts.variance[:, 0, 0])
figure, ax = plt.subplots(layout="constrained")
for number, (scene, marker) in enumerate(zip((0, 2, 14), "os^", strict=True)):
    at = np.arange(1, 9) + 0.15 * (number - 1)
    ax.errorbar(at, signal[scene], spread[scene], fmt=marker, label=f"a {scene // 2}", capsize=2)
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
#    Not with eight frames. The shortest frame is counted for 32 µs: 44 µs less 10 µs, in which the
#    mirrors settle, and 2 µs of margin. So up to 31 frames fit into the exposure. The training
#    reads this limit from the camera, and gives every frame at least 32 µs.
#
# **2.** Your detector has an efficiency of 0.25, and 10⁵ photons reach the device. Which budget
# does the classifier get?
#
# .. dropdown:: Answer
#
#    2.5 · 10⁴. In the counts, a photon that is not detected is the same as one that never came. So
#    the camera works as an ideal one with the budget times the efficiency. ``camera count`` finds
#    the budget from the all-ON frames, efficiency included.
#
# **3.** Count the recording with ``--dead-time 0``. Which frames lose most?
#
# .. dropdown:: Answer
#
#    The brightest ones, most of all the all-ON frames. The budget is then estimated too low, and
#    the masks' counts are too large for it.
