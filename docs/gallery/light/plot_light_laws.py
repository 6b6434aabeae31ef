"""
What one real device costs
==========================

One micromirror device shows masks one after another, and this costs accuracy. The optics of the
paper split each pixel's light among all masks at once. A *light law* says what optics allow.
"""

import matplotlib.pyplot as plt

import deepfsi
from deepfsi.report.style import DESIGN_COLOURS

# %%
# Eight masks are learned at 3000 photons under each of four light laws. ``column`` is the paper's.
# ``two-arm`` is one device with a second detector for the mirrors that are OFF. ``free-dwell`` and
# ``equal-dwell`` are one device with one detector, with free or with equal times of the frames.
# Masks of ``column`` and ``two-arm`` are signed, in two rails, which these cameras count at once.
# The others are non-negative.

digits = deepfsi.load_dataset("digits")
cameras = [
    deepfsi.Camera(light=light) for light in ("column", "two-arm", "free-dwell", "equal-dwell")
]
results = []
for camera in cameras:
    design = deepfsi.learn(digits, camera=camera, photons=3e3, masks=8, training={"epochs": 25})
    results += deepfsi.evaluate(design, digits, 3e3)

# %%
# The accuracy has 95 % intervals over 360 test pictures. Below it are the photons that are counted,
# of 3000. One detector misses the light of all mirrors that are OFF. Two arms count it all, but
# each mask has only its share of the time.

figure, (above, below) = plt.subplots(2, 1, figsize=(4.8, 4.4), sharey=True, layout="constrained")
places = range(len(cameras))
accuracy = [each.accuracy for each in results]
low = [each.accuracy - each.low for each in results]
high = [each.high - each.accuracy for each in results]
look = {"fmt": "o", "color": DESIGN_COLOURS["deepfsi"], "capsize": 3}
above.errorbar(accuracy, places, xerr=(low, high), **look)
above.axvline(0.1, color="0.4", linestyle=":")
above.text(0.12, 3.4, "guessing", va="bottom")
names = [camera.light for camera in cameras]
above.set(yticks=places, yticklabels=names, xlim=(0, 1), ylim=(3.7, -0.5), xlabel="accuracy")
below.barh(places, [each.counts for each in results], color="0.4", height=0.5)
below.set(xlabel="photons counted, of 3000", xlim=(0, 3100))
plt.show()
