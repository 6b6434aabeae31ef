"""
A classifier without torch
==========================

The classifier of a design becomes an ONNX graph, which turns counts and a photon budget into class
probabilities. ONNX Runtime gives the same answers as torch, and classifies one exposure at a time.
"""

import time

import matplotlib.pyplot as plt
import numpy as np
import onnxruntime
import torch

import deepfsi
from deepfsi.design.onnx import to_onnx

# %%
# A design with one rail, and Poisson counts of the test pictures, as a camera would measure them.

digits = deepfsi.load_dataset("digits")
design = deepfsi.learn(digits, photons=1e4, masks=10, training={"epochs": 20})
scenes = torch.from_numpy(digits.x_test)
photons = deepfsi.photons_per_pixel(scenes, 1e4, design.summed_reflectance)
counts = design.scanner().counts(photons, torch.Generator().manual_seed(0)).numpy()[:, 0]

# %%
# ``to_onnx`` gives the content of an ``.onnx`` file. The graph does all scaling. The figure shows
# the probabilities of all classes, and how long each classification took on the machine that built
# this page.

session = onnxruntime.InferenceSession(to_onnx(design))
budget = np.array([1e4], np.float32)
answers, seconds = [], []
for exposure in counts:
    began = time.perf_counter()
    [answer] = session.run(None, {"counts": exposure[None], "photons": budget})
    seconds.append(time.perf_counter() - began)
    answers.append(answer[0])
expected = design.classify(counts, 1e4)
print(f"largest difference of a probability: {abs(np.array(answers) - expected).max():.1e}")

figure, (left, right) = plt.subplots(1, 2, figsize=(4.8, 2.6), layout="constrained")
left.plot(expected.ravel(), np.ravel(answers), ".", markersize=3)
left.plot((0, 1), (0, 1), color="0.4", linestyle=":")
left.set(xlabel="torch", ylabel="ONNX Runtime", title="probability", aspect="equal")
right.hist(1e6 * np.array(seconds), bins=np.geomspace(3, 3000, 31), color="0.4")
right.set(xscale="log", xlabel="time (µs)", ylabel="exposures, of 360", title="classification")
right.xaxis.set_major_formatter("{x:g}")
plt.show()
