"""
Masks against light
===================

The best masks depend on the light. With 100 photons each mask takes all the light of a few pixels.
With 10⁴ and 10⁶ photons all masks share every pixel.
"""

import matplotlib.pyplot as plt

import deepfsi
from deepfsi.report.style import photons_text

# %%
# The paper's camera is learned at each of the three budgets. A design is six masks and the network
# that reads their counts. The optics split the light of each pixel among all masks (``column``). A
# design is tested on pictures that it was not trained on, under exact photon noise.

digits = deepfsi.load_dataset("digits")
designs, results = {}, {}
for photons in (1e2, 1e4, 1e6):
    designs[photons] = deepfsi.learn(
        digits, camera="paper", photons=photons, masks=6, training={"epochs": 20}
    )
    [results[photons]] = deepfsi.evaluate(designs[photons], digits, photons)

# %%
# Each mask has, for every pixel, the share of its photons that is counted: red on the first rail
# (added), blue on the second (subtracted). Each row has its own scale. Intervals are of 95 %, over
# 360 test pictures, for these trained designs.

figure = plt.figure(figsize=(4.8, 4.2), layout="constrained")
for part, (photons, design) in zip(figure.subfigures(3, 1), designs.items(), strict=True):
    peak = abs(design.matrix).max()
    axes = part.subplots(1, 6)
    for ax, mask in zip(axes, design.matrix, strict=True):
        image = ax.imshow(mask.reshape(8, 8), cmap="RdBu_r", vmin=-peak, vmax=peak)
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set_visible(True)
    result = results[photons]
    interval = f"{result.accuracy:.2f} [{result.low:.2f}, {result.high:.2f}]"
    part.suptitle(f"{photons_text(photons)} photons: accuracy {interval}")
    part.colorbar(image, ax=axes, ticks=[-peak, 0, peak], format="%.2f", label="share of light")
plt.show()
