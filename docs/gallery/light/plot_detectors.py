"""
Several detectors
=================

The device may be divided among detectors that see each frame at once. One detector is the
single-pixel camera; more detectors lose less light to time-sharing.
"""

import matplotlib.pyplot as plt

import deepfsi
from deepfsi.report.style import COLOURS, STYLE

plt.rcParams.update(STYLE)

# %%
# Non-negative masks for one device. Each frame is read by D detectors, each behind its own part of
# the pixels; 16 readouts in all, so that fewer frames are shown where there are more detectors.

digits = deepfsi.load_dataset("digits")
parts = {"1x1": 16, "1x2": 8, "2x2": 4, "4x4": 1}
results = []
for detectors, masks in parts.items():
    design = deepfsi.learn(
        digits,
        photons=3e3,
        masks=masks,
        camera={"detectors": detectors},
        training={"epochs": 20},
    )
    results += deepfsi.evaluate(design, digits, 3e3)

# %%
# More detectors count more of the same light, up to what 16 readouts can tell.

figure, ax = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
accuracy = [each.accuracy for each in results]
low = [each.accuracy - each.low for each in results]
high = [each.high - each.accuracy for each in results]
ax.errorbar(range(4), accuracy, (low, high), fmt="o", color=COLOURS["deepfsi"], capsize=3)
ax.axhline(0.1, color="0.4", linestyle=":")
ax.text(3.3, 0.11, "guessing", ha="right", va="bottom")
names = [f"{d}\n{m} frame{'s' * (m > 1)}" for d, m in parts.items()]
ax.set(xticks=range(4), xticklabels=names, xlim=(-0.4, 3.4), ylim=(0, 1))
ax.set(xlabel="detectors (rows x columns) and frames shown", ylabel="accuracy")
ax.set_title("16 readouts at 3000 photons")
figure.supxlabel("95 % intervals over 360 test pictures, for one training each", fontsize=9)
plt.show()
