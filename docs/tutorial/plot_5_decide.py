"""
5. How much light do you need?
==============================

At the end of this page you have a decision: the photons and the exposure time that an accuracy
needs. You also know what is gained when exposures stop early.
"""

import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.sweeps.results import read_results

# %%
# From an accuracy to photons
# ---------------------------
#
# Say that 80 % of the answers must be right. ``compare`` trains each design at each budget.

os.system(
    "deepfsi compare --data my-pictures --designs pca,deepfsi "
    "--photons 1e2,1e3,2e3,1e4 --masks 8 --trials 1 --epochs 15 --workers 1 -o target"
)

# %%
# The light that a design surely has enough of is the first budget whose interval is above 0.8. In
# the figure bars are 95 % intervals over test pictures.

results = read_results(Path("target/results.json"))
figure, ax = plt.subplots(layout="constrained")
needs = {}
for design, marker, colour in (("deepfsi", "o", "#d55e00"), ("pca", "D", "#0072b2")):
    tried = sorted((p for p in results.points if p.design == design), key=lambda p: p.photons)
    photons = [each.photons for each in tried]
    accuracy = np.array([each.accuracy for each in tried])
    low = accuracy - [each.low for each in tried]
    high = [each.high for each in tried] - accuracy
    style = {"color": colour, "marker": marker, "capsize": 3}
    ax.errorbar(photons, accuracy, (low, high), label=tried[0].title, **style)
    needs[design] = next((each.photons for each in tried if each.low > 0.8), photons[-1])
ax.axhline(0.8, color="0.4", linestyle=":")
ax.set(xscale="log", xlabel="photon budget", ylabel="accuracy", ylim=(0, 1))
ax.legend(loc="lower right")
plt.show()

# %%
# From photons to time
# --------------------
#
# Measure the **flux**: counts per second with all mirrors ON, before the mean scene. Then the
# exposure is photons / flux.

most = needs["deepfsi"]
for flux in (1e5, 1e6, 1e7):
    print(f"flux {flux:.0e}/s: {1e3 * most / flux:.2f} ms")

# %%
# Stop an exposure early
# ----------------------
#
# Easy scenes need less light than hard ones. With **adaptive** masks an exposure may end as soon as
# a class is sure, and what it saves goes to hard scenes. With ``--cap 2`` the budget is the mean
# over scenes, and no exposure takes more than twice of it.

words = "deepfsi design --data my-pictures --design adaptive --photons 2e2"
os.system(f"{words} --masks 8 -o equal.safetensors")
os.system(f"{words} --masks 16 --cap 2 -o shared.safetensors")

# %%
# The training found the probability above which an exposure ends. Both designs take the same light
# in the mean. The bars are 95 % intervals over 360 test pictures.

figure, ax = plt.subplots(layout="constrained")
shown = {"each 200 photons": "equal", "200 in the mean, at most 400": "shared"}
results = [
    deepfsi.evaluate(deepfsi.load_design(f"{name}.safetensors"), "my-pictures", 2e2)[0]
    for name in shown.values()
]
accuracy = np.array([each.accuracy for each in results])
low = accuracy - [each.low for each in results]
high = [each.high for each in results] - accuracy
ax.bar([*shown], accuracy, yerr=(low, high), color=("#0072b2", "#d55e00"), capsize=3, width=0.5)
ax.set(ylabel="accuracy", ylim=(0, 1))
plt.show()

# %%
# Decide
# ------
#
# Now you can write down a decision, with the numbers of this page:

print(f"For an accuracy of 0.8 we give 8 learned masks {most:.0f} photons.")
print(f"At 10⁶ photons/s that is {1e3 * most / 1e6:.1f} ms an exposure.")
print(f"Sharing 200 photons among scenes: {accuracy[1]:.3f} in place of {accuracy[0]:.3f}.")

# %%
# These numbers hold for pictures like yours, one device with one detector, and no stray light.
#
# Exercises
# ---------
#
# **1.** The lamp can be made twice as bright. What happens to the photons needed, and to the time?
#
# .. dropdown:: Answer
#
#    The photons needed stay: they depend on the pictures and the design. The time halves.
#
# **2.** Your task needs 0.99 instead, which no budget of the table reaches. What do you try?
#
# .. dropdown:: Answer
#
#    Higher budgets (``--photons 1e3,1e4,1e5,1e6``), and more masks (``--masks 8,16,32``). If the
#    curve stays flat below 0.99, try more training pictures, larger ones or another network.
#
# **3.** Why are the threshold and the number of masks not chosen on the test pictures?
#
# .. dropdown:: Answer
#
#    The best of several noisy results is often one that is high by chance. On the pictures that the
#    choice was made with, it looks better than it is. The test pictures are read once, after all
#    choices.
