"""
3. Compare, and read an interval
================================

At equal light, this page compares a learned design with a raster scan and with principal
components (PCA), so that you see whether learning is worth it for your pictures. Then it compares
what different optics allow.
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
# Every design is trained on the same pictures and for as long. Each is trained three times
# (``--trials 3``), every time with other initial weights and another order of the pictures.

os.system(
    "deepfsi compare --data my-pictures --designs raster,pca,deepfsi "
    "--photons 1e2,1e3,1e4 --masks 8 --trials 3 --epochs 12 --workers 1 -o runs/mine"
)

# %%
# Open the report ``runs/mine/report.html`` in a browser. The numbers are also in
# ``runs/mine/results.json``, from which this figure is drawn. Its bars are 95 % intervals over
# three trainings.

results = json.loads(Path("runs/mine/results.json").read_text())
figure, ax = plt.subplots(layout="constrained")
looks = {
    "raster": ("#7a838d", ":", "s"),
    "pca": ("#0072b2", "-", "D"),
    "deepfsi": ("#d55e00", "-", "o"),
}
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
ax.legend(loc="lower right", bbox_to_anchor=(1, 0.18))
plt.show()

# %%
# Read an interval
# ----------------
#
# Ask of every interval what it **covers**. A line below the tables says it: *test images, noise
# draws and training seeds (3 trainings)*. None covers pictures of another kind than yours.
#
# Where two intervals overlap, the designs may still differ, as all are tested with the same
# pictures. The report compares them picture by picture, and says which cannot be told apart.
#
# The best design at one budget need not be the best at another, so compare at the budgets of your
# own camera. Here the raster scan comes close at 10⁴ photons. The pictures have only 64 pixels,
# half of them black, so that a white pixel gives about eight counts.

# %%
# What your optics allow
# ----------------------
#
# Optics cannot use a photon twice. A **light law** says what masks may do with the photons. Choose
# the one that your hardware has, with ``--light``:
#
# ``column``
#     Optics split each pixel's light among all masks, so that a pixel's shares sum to at most 1. No
#     single device does that. It is the paper's constraint, and a bound for the others.
# ``free-dwell``
#     One device and one detector, each frame shown for its own part of the time. The comparison
#     above used it, because no other camera was given.
# ``equal-dwell``
#     The same with equal times, for a device whose frame rate is fixed.
# ``two-arm``
#     A second detector sees the mirrors that are OFF.
#
# For each law a design is learned at 1000 photons. The script prints its accuracy with the 95 %
# interval over test images, and how many of the 1000 photons are counted:

data = deepfsi.load_dataset("my-pictures")
for light in ("column", "two-arm", "free-dwell", "equal-dwell"):
    camera = deepfsi.Camera(light=light)
    design = deepfsi.learn(data, camera=camera, photons=1e3, masks=8, training={"epochs": 15})
    [each] = deepfsi.evaluate(design, data, 1e3)
    interval = f"[{each.low:.3f}, {each.high:.3f}]"
    print(f"{light:12}{each.accuracy:.3f} {interval}{each.counts:5.0f}")

# %%
# The difference between ``column`` and the others is what one device costs. Its frames share the
# time, and with one detector the light of OFF mirrors is lost. With two arms no light is lost, but
# only one mask is shown at any moment. The optics of ``column`` apply all masks at once.
#
# Exercises
# ---------
#
# **1.** The interval of one design is [0.80, 0.88], of another [0.86, 0.92], both over test images.
# Is the second better?
#
# .. dropdown:: Answer
#
#    These two intervals do not decide it. Both designs were tested on the same pictures: a paired
#    comparison can decide.
#
# **2.** Add ``impulse`` to the designs, with ``--camera paper`` (``column``, dual rails). Why is
# impulse imaging the best, and why is it not possible here?
#
# .. dropdown:: Answer
#
#    It has a detector for every pixel, each exposed all the time. So it counts every photon, and
#    records where it came from. Under photon noise no design of ``column`` tells more, given the
#    best network for each. A camera with one detector cannot do that.
#
# **3.** How does the accuracy of the learned design change with 4 or 16 masks (``--masks 4,16``)?
#
# .. dropdown:: Answer
#
#    Few masks have more light each, many masks tell more. With little light few masks are better,
#    with much light many. ``compare`` chooses the number of masks on validation pictures, not on
#    test pictures.
