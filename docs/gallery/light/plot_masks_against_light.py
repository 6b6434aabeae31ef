"""
Masks against light
===================

The paper's camera is learned three times, for 100, 10⁴ and 10⁶ photons an exposure. With 100
photons each mask takes all the light of a few pixels. With more light, all masks share every pixel.
"""

import matplotlib.pyplot as plt

import deepfsi
from deepfsi.report.style import STYLE, photons_text

plt.rcParams.update(STYLE)

# %%
# A design is six masks and the network that reads their counts. The optics split the light of each
# pixel among all masks (``column``). It is tested on pictures that it was not trained on, under
# exact photon noise.

digits = deepfsi.load_dataset("digits")
designs, results = {}, {}
for photons in (1e2, 1e4, 1e6):
    designs[photons] = deepfsi.learn(
        digits, camera="paper", photons=photons, masks=6, training={"epochs": 20}
    )
    [results[photons]] = deepfsi.evaluate(designs[photons], digits, photons)

# %%
# Each mask holds, for every pixel, the share of its photons that is counted: red on the first rail
# (added), blue on the second (subtracted). Each row is drawn on its own scale.

figure = plt.figure(figsize=(6.4, 4.6), layout="constrained")
for part, (photons, design) in zip(figure.subfigures(3, 1), designs.items(), strict=True):
    peak = abs(design.matrix).max()
    axes = part.subplots(1, 6)
    for ax, mask in zip(axes, design.matrix, strict=True):
        image = ax.imshow(mask.reshape(8, 8), cmap="RdBu_r", vmin=-peak, vmax=peak)
        ax.set(xticks=[], yticks=[])
        ax.spines[:].set_visible(True)
    result = results[photons]
    interval = f"{result.accuracy:.2f} [{result.low:.2f}, {result.high:.2f}]"
    part.suptitle(f"{photons_text(photons)} photons: accuracy {interval}", fontsize=9)
    part.colorbar(image, ax=axes, ticks=[-peak, 0, peak], format="%.2f", label="share of light")
figure.supxlabel("95 % intervals over 360 test pictures, for these trained designs", fontsize=9)
plt.show()
