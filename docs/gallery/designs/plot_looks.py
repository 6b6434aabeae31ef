"""
Looks: counts choose what is shown next
=======================================

An exposure is divided into four looks. After each look a network chooses, from the counts so far,
for how long each mask is shown in the next one. The classifier answers after every look.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi

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
# ``classify_live`` asks for the counts of each look. Here Poisson numbers stand for the camera. In
# ``scene`` are the counts that each mask would give if it were shown for the whole exposure.

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


answer = design.classify_live(show, PHOTONS, note)
print(f"answer: {digits.classes[answer.argmax()]}, probability {answer.max():.3f}")

# %%
# The budget is 10⁴ photons. Above, the scene, and the probability of three classes after each look.
# Below, the time of each mask in each look. The times of the first look are the same for every
# scene, the others are chosen from the counts.

figure, axes = plt.subplot_mosaic(
    [["scene", "answer"], ["times", "times"]],
    figsize=(4.8, 4.8),
    width_ratios=(1, 2),
    layout="constrained",
)
axes["scene"].imshow(picture.reshape(8, 8), cmap="gray", vmin=0, vmax=1)
axes["scene"].set(xticks=[], yticks=[], title=f"scene: a {digits.classes[digits.y_test[17]]}")
likeliest = np.argsort(-np.mean(chances, axis=0))[:3]
for place, marker in zip(likeliest, "os^", strict=True):
    line = [probabilities[place] for probabilities in chances]
    axes["answer"].plot(range(1, 5), line, marker=marker, label=digits.classes[place])
axes["answer"].set(xticks=range(1, 5), xlabel="looks so far", ylabel="probability", ylim=(0, 1.02))
axes["answer"].legend(title="class", loc="center right")
image = axes["times"].imshow(100 * np.array(dwells), cmap="cividis", vmin=0, aspect="auto")
axes["times"].set(xticks=range(12), xticklabels=range(1, 13), xlabel="mask")
axes["times"].set(
    yticks=range(4), yticklabels=range(1, 5), ylabel="look", title="time of each mask"
)
figure.colorbar(image, ax=axes["times"], label="% of the exposure")
plt.show()
