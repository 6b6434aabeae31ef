"""
Several detectors
=================

With the same light, several detectors behind one device classify better than one. Each sees its own
part of the mirrors in every frame, so fewer frames share the time.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.base.intervals import paired_difference
from deepfsi.report.style import DESIGN_COLOURS

# %%
# Four cameras have 16 readouts each: one detector and 16 frames, two and 8, four and 4, or 16 and
# one frame. Masks are non-negative, and the budget is 3000 photons.

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
# The bars are 95 % intervals over 360 test pictures, for one training each. Designs are compared
# picture by picture, since the same pictures are hard for both: where the interval of the
# difference contains 0, these pictures do not decide.

names = [*parts]
for place in range(1, 4):
    more, fewer = ([results[k].right] for k in (place, place - 1))
    gain = paired_difference(np.array(more), np.array(fewer))
    print(f"{names[place]} less {names[place - 1]}: {gain}")

# %%
# The same as a figure:

figure, ax = plt.subplots(layout="constrained")
accuracy = [each.accuracy for each in results]
low = [each.accuracy - each.low for each in results]
high = [each.high - each.accuracy for each in results]
ax.errorbar(range(4), accuracy, (low, high), fmt="o", color=DESIGN_COLOURS["deepfsi"], capsize=3)
ax.axhline(0.1, color="0.4", linestyle=":")
ax.text(3.3, 0.11, "guessing", ha="right", va="bottom")
names = [f"{d.replace('x', ' × ')}\n{m} frame{'s' * (m > 1)}" for d, m in parts.items()]
ax.set(xticks=range(4), xticklabels=names, xlim=(-0.4, 3.4), ylim=(0, 1))
ax.set(xlabel="detectors (rows × columns), frames", ylabel="accuracy")
ax.set_title("16 readouts at 3000 photons")
plt.show()
