"""
3. Compare, and read an interval
================================

Is a learned design worth it for your pictures? This page compares it with a raster scan and with
principal components at equal light, and then asks what your optics allow.
"""

import json
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import deepfsi

# %%
# Three designs, three budgets
# ----------------------------
#
# Every design gets the same training, on the same pictures and for as long. Three trainings each
# (``--trials 3``), with other initial weights and another order of the pictures.

os.system(
    "deepfsi compare --data my-pictures --designs raster,pca,deepfsi "
    "--photons 1e2,1e3,1e4 --masks 8 --trials 3 --epochs 12 --workers 1 -o runs/mine"
)

# %%
# The report of this comparison is ``runs/mine/report.html``; open it in a browser. The numbers are
# in ``runs/mine/results.json``.

results = json.loads(Path("runs/mine/results.json").read_text())
figure, ax = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
looks = {"raster": ("gray", ":", "s"), "pca": ("C0", "-", "D"), "deepfsi": ("C1", "-", "o")}
for place, (name, (colour, line, marker)) in enumerate(looks.items()):
    points = [each for each in results["points"] if each["design"] == name]
    photons = np.array([each["photons"] for each in points])
    accuracy = np.array([each["accuracy"] for each in points])
    low = accuracy - [each["low"] for each in points]
    high = [each["high"] for each in points] - accuracy
    ax.errorbar(
        photons * 1.03**place,
        accuracy,
        (low, high),
        color=colour,
        linestyle=line,
        marker=marker,
        capsize=3,
        label=points[0]["title"],
    )
ax.axhline(0.1, color="0.4", linestyle=":")
ax.text(1e4, 0.11, "guessing", ha="right", va="bottom")
ax.set(xscale="log", xlabel="photon budget", ylabel="accuracy", ylim=(0, 1))
ax.legend(loc="lower right", bbox_to_anchor=(1, 0.15))
figure.supxlabel("95 % intervals over three trainings", fontsize=9)
plt.show()

# %%
# Read an interval
# ----------------
#
# Ask of every interval what it **covers**. The table says it in a line below: *training seeds
# (Student's t over 3 trials)*. So these bars tell how far another training of the same design would
# differ. They are wide because three trainings tell little about their spread. The interval of page
# 2 covered test images instead. Neither covers pictures of another kind than yours.
#
# Where two intervals are far apart, the designs differ. Where they overlap a little, they may still
# differ; where they overlap much, more trials or more test pictures must decide. A design that wins
# at one budget need not win at another: compare at the budgets of your own camera. Here the raster
# scan comes close at 10⁴ photons: the pictures have only 64 pixels, half of them black, so that a
# white one gives about eight counts.

# %%
# What your optics allow
# ----------------------
#
# A **light law** says what masks may do with the photons, because optics cannot use a photon
# twice. Choose the one that your hardware realises, with ``--light``:
#
# ``column``
#     each pixel's shares sum to at most 1: optics that split each pixel's light among the readouts.
#     No single device does that. It is the paper's constraint, and a bound for the others.
# ``free-dwell``
#     one device, one detector, each frame for its own part of the time. The comparison above used
#     it, because no other camera was given.
# ``equal-dwell``
#     the same with equal times, for a device whose frame rate is fixed.
# ``two-arm``
#     a second detector sees the mirrors that are OFF.

data = deepfsi.load_dataset("my-pictures")
for light in ("column", "two-arm", "free-dwell", "equal-dwell"):
    camera = deepfsi.Camera(light=light)
    design = deepfsi.learn(data, camera=camera, photons=1e3, masks=8, training={"epochs": 15})
    [each] = deepfsi.evaluate(design, data, 1e3)
    print(
        f"{light:12} accuracy {each.accuracy:.3f} [{each.low:.3f}, {each.high:.3f}], "
        f"{each.counts:.0f} of 1000 photons counted"
    )

# %%
# The distance from ``column`` to the others is what one device costs. Its frames share the time,
# and with one detector the light of OFF mirrors is lost. On two arms no light is lost, but at any
# moment one mask alone sorts the photons, where ``column`` sorts them by all masks at once.
#
# Exercises
# ---------
#
# **1.** The interval of one design is [0.80, 0.88], of another [0.86, 0.92], both over test images.
# Is the second better?
#
# .. dropdown:: Answer
#
#    It may be, and these two intervals do not decide it. They were tested on the same pictures, so
#    the difference is known better than each accuracy; a paired comparison, or more test pictures,
#    tells.
#
# **2.** Add ``impulse`` to the designs, with ``--camera paper`` (``column``, dual rails). Why does
# impulse imaging win, and why is it no option here?
#
# .. dropdown:: Answer
#
#    It has a detector for every pixel, each exposed all the time, so that it counts every photon
#    and where it came from. Under photon noise no design of ``column`` tells more, given the best
#    network for each. A camera with one detector cannot do that.
#
# **3.** How does the accuracy of the learned design change with 4 or 16 masks (``--masks 4,16``)?
#
# .. dropdown:: Answer
#
#    Few masks have more light each, many masks tell more. With little light few masks are better,
#    with much light many. ``compare`` chooses the count on validation pictures, not on the test.
