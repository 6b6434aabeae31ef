"""
What one real device costs
==========================

A light law says what masks may do with the photons. The paper's, ``column``, splits each
pixel's light among all readouts; one micromirror device shows masks one after another.
"""

import matplotlib.pyplot as plt

import deepfsi
from deepfsi.report.style import COLOURS, STYLE

plt.rcParams.update(STYLE)

# %%
# Eight masks at 3000 photons under each constraint. ``free-dwell`` and ``equal-dwell`` are one
# device with one detector, ``two-arm`` has a second detector for the mirrors that are OFF. Masks
# are signed, in two rails, where the camera can show both at once.

digits = deepfsi.load_dataset("digits")
cameras = [
    deepfsi.Camera(light=light) for light in ("column", "two-arm", "free-dwell", "equal-dwell")
]
results = []
for camera in cameras:
    design = deepfsi.learn(digits, camera=camera, photons=3e3, masks=8, training={"epochs": 25})
    results += deepfsi.evaluate(design, digits, 3e3)

# %%
# The right panel says how many of the 3000 photons on the device are counted. One detector misses
# the light of all mirrors that are OFF. Two arms count it all, but each mask has only its share of
# the time.

figure, (left, right) = plt.subplots(1, 2, figsize=(6.4, 3.4), sharey=True, layout="constrained")
places = range(len(cameras))
accuracy = [each.accuracy for each in results]
low = [each.accuracy - each.low for each in results]
high = [each.high - each.accuracy for each in results]
left.errorbar(accuracy, places, xerr=(low, high), fmt="o", color=COLOURS["deepfsi"], capsize=3)
left.axvline(0.1, color="0.4", linestyle=":")
left.text(0.12, 3.4, "guessing", va="bottom")
names = [f"{camera.light}, {camera.rails}" for camera in cameras]
left.set(yticks=places, yticklabels=names, xlim=(0, 1), ylim=(3.7, -0.5), xlabel="accuracy")
left.set_title("95 % over 360 test pictures")
right.barh(places, [each.counts for each in results], color="#5d6670", height=0.5)
right.axvline(3000, color="0.4", linestyle=":")
right.set(xlabel="photons counted of 3000", xlim=(0, 3100))
plt.show()
