"""
Looks: counts choose what is shown next
=======================================

The exposure is cut into four looks. After each one a network chooses, from the counts so far, for
how long each mask is shown in the next look, and the classifier gives its answer so far.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.report.style import STYLE

plt.rcParams.update(STYLE)
PHOTONS = 1e4

# %%
# Twelve masks of mirrors that are ON or OFF (two levels), for one device and one detector.

digits = deepfsi.load_dataset("digits")
design = deepfsi.learn(
    digits,
    photons=PHOTONS,
    masks=12,
    camera={"levels": 2},
    exposure=deepfsi.Looks(looks=4),
    training={"epochs": 25},
)

# %%
# ``classify_live`` asks for the counts of each look. Here a Poisson draw stands for the camera;
# ``scene`` holds the counts that each mask would give if it were shown for the whole exposure.

picture = digits.x_test[17]
photons = deepfsi.photons_per_pixel(picture, PHOTONS, design.summed_reflectance)
scene = design.rails.plus.numpy() * design.masks @ photons
rng = np.random.default_rng(1)
dwells, chances = [], []


def show(dwell):
    """Counts of one look, in which mask i has the share dwell[i] of the exposure."""
    dwells.append(dwell)
    return rng.poisson(scene * dwell)


def note(look, probabilities, photons):
    """Keep the probabilities after each look, and go on."""
    chances.append(probabilities)
    return False


design.classify_live(show, PHOTONS, note)

# %%
# Left, the picture. Middle, the time of each mask in each look: equal for every scene in the first
# look, chosen from the counts in the others. Right, the answer after each look.

figure, (left, middle, right) = plt.subplots(
    1, 3, figsize=(6.4, 3.2), width_ratios=(1, 1.6, 1.8), layout="constrained"
)
left.imshow(picture.reshape(8, 8), cmap="gray", vmin=0, vmax=1)
left.set(xticks=[], yticks=[], title=f"scene: a {digits.classes[digits.y_test[17]]}")
image = middle.imshow(100 * np.array(dwells).T, cmap="cividis", vmin=0, aspect="auto")
middle.set(xticks=range(4), xticklabels=range(1, 5), yticks=(0, 11), yticklabels=(1, 12))
middle.set(xlabel="look", ylabel="mask", title="time of each mask")
figure.colorbar(image, ax=middle, label="% of the exposure")
likeliest = np.argsort(-np.mean(chances, axis=0))[:3]
for place, marker, colour in zip(likeliest, "os^", ("#d55e00", "#0072b2", "#009e73"), strict=True):
    line = [probabilities[place] for probabilities in chances]
    right.plot(range(1, 5), line, marker=marker, color=colour, label=digits.classes[place])
right.set(xticks=range(1, 5), xlabel="looks so far", ylabel="probability", ylim=(0, 1.02))
right.set_title("answer, at 10⁴ photons")
right.legend(title="class", loc="center right")
plt.show()
