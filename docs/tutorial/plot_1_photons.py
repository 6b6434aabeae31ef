"""
1. Your pictures as photons
===========================

At the end of this tutorial you know which masks, how many photons and how long an exposure your
task needs. It has five pages. This one turns your pictures into photon counts.

Every number was computed when the site was built, with small settings. Each page is a Python
script: download it at its end, and run it in the folder that holds your pictures. Commands are
those that you type in a terminal there.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi

# %%
# A folder of pictures
# --------------------
#
# Your data is a folder with one sub-folder for each class::
#
#     my-pictures/
#       0/  0000.png  0010.png  ...
#       1/  0001.png  0011.png  ...
#
# On these pages ``my-pictures`` holds 1797 handwritten digits of 8 × 8 pixels, which train in
# seconds.
#
# .. dropdown:: No pictures at hand?
#
#    These lines write the digits (:download:`my_pictures.py </tutorial/my_pictures.py>`):
#
#    .. literalinclude:: /tutorial/my_pictures.py
#       :lines: 3-

data = deepfsi.load_dataset("my-pictures")
print(data.preprocessing)
print(len(data.x_train), "pictures to train with,", len(data.x_test), "to test with")

# %%
# A fifth of the pictures of each class is set aside for tests; no training ever sees it. Pixel
# values become *reflectance*, 0 for black and 1 for white. Larger pictures are averaged to the size
# that you want: ``load_dataset("my-pictures", size=(32, 32))``.

# %%
# The photon budget
# -----------------
#
# A camera does not see reflectance; it counts photons. The **photon budget** Φ is the number of
# photons that are expected to reach the coding device (the micromirrors) in one exposure, in the
# mean over the training scenes.
#
# Let s be the summed reflectance of a training scene, in the mean. Then a pixel of reflectance x
# receives λ = Φ x / s photons in the mean. Illumination is fixed: a brighter scene sends more
# photons.

brightness = float(data.x_train.sum(axis=1).mean())
scene = data.x_test[0]
for photons in (1e2, 1e4):
    expected = deepfsi.photons_per_pixel(scene, photons, brightness)
    print(f"budget {photons:g}: this scene sends {expected.sum():.0f} photons")

# %%
# Photons arrive at random. If λ are expected, the count is a Poisson number with mean λ and
# standard deviation √λ: 100 photons are known to 10 %, 10⁴ to 1 %. This *photon noise* belongs to
# light itself, and no detector is without it.
#
# The figure shows the same scene at four budgets, counted in two ways. *Impulse imaging* has a
# detector for every pixel, and each counts for the whole exposure. A *raster scan* has one
# detector, and shows it one pixel after another, each for 1/64 of the exposure. Each picture is
# drawn from black, no count, to white, its own largest count.

rng = np.random.default_rng(0)
budgets = {"100 photons": 1e2, "1000 photons": 1e3, "10⁴ photons": 1e4, "10⁵ photons": 1e5}
figure, axes = plt.subplots(2, 4, figsize=(4.8, 3), layout="constrained")
for column, (name, photons) in zip(axes.T, budgets.items(), strict=True):
    expected = deepfsi.photons_per_pixel(scene, photons, brightness)
    impulse, raster = rng.poisson(expected), rng.poisson(expected / data.pixels)
    for ax, counts in zip(column, (impulse, raster), strict=True):
        ax.imshow(counts.reshape(8, 8), cmap="gray", vmin=0)
        ax.set(xticks=[], yticks=[], xlabel=f"counts: {counts.sum()}")
    column[0].set_title(name)
axes[0, 0].set_ylabel("impulse imaging")
axes[1, 0].set_ylabel("raster scan")
plt.show()

# %%
# The raster scan loses 63 of 64 photons, because the mirrors of all other pixels are OFF. A
# *mask* with many mirrors ON at once counts more of the light. The next page learns which mirrors
# to turn ON for a given question.
#
# Exercises
# ---------
#
# **1.** How many photons does a raster scan of a 32 × 32 picture count, in the mean, at a budget of
# 10⁴?
#
# .. dropdown:: Answer
#
#    10⁴ / 1024, about 10. Each pixel is seen for 1/1024 of the exposure, so 1/1024 of its photons
#    are counted. The sum over all N pixels is Φ/N.
#
# **2.** Your scene sends 2 · 10⁶ photons per second to the device. How long is an exposure of 10⁴
# photons?
#
# .. dropdown:: Answer
#
#    10⁴ / (2 · 10⁶ per second) = 5 ms. A budget is flux times time.
#
# **3.** A pixel expects 4 photons. How likely is it that none is counted?
#
# .. dropdown:: Answer
#
#    exp(−4), about 2 %. So a white pixel may look black, and a picture with few photons has holes.
