"""
Nested masks
============

Nested masks are ordered, and one network can answer after any number of them. So one design serves
short sequences and long ones, and an exposure may end early.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.report.style import DESIGN_COLOURS

# %%
# Sixteen non-negative masks for one micromirror device and one detector, each shown for its own
# time. ``nested=2`` lets the network answer from the first two masks on.

digits = deepfsi.load_dataset("digits")
design = deepfsi.learn(
    digits, photons=1e5, masks=16, exposure=deepfsi.Nested(nested=2), training={"epochs": 60}
)

# %%
# ``design.first(k)`` keeps the first k masks, which then share the whole exposure. Bars are 95 %
# intervals over 360 test pictures, for this trained design.

counts = [2, 3, 4, 6, 8, 12, 16]
results = [deepfsi.evaluate(design.first(k), digits, 1e5)[0] for k in counts]

accuracy = np.array([result.accuracy for result in results])
low = accuracy - [result.low for result in results]
high = [result.high for result in results] - accuracy

figure, ax = plt.subplots(layout="constrained")
ax.errorbar(counts, accuracy, (low, high), color=DESIGN_COLOURS["deepfsi"], marker="o", capsize=3)
ax.axhline(0.1, color="0.4", linestyle=":")
ax.text(16, 0.11, "guessing", ha="right", va="bottom")
ax.set(xlabel="masks shown", ylabel="accuracy", ylim=(0, 1), xticks=range(2, 17, 2))
ax.set_title("one design of 16 nested masks at 10⁵ photons")
plt.show()
