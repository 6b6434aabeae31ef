"""
What the camera sees
====================

Twenty masks give counts that are enough for a class, but hardly for a picture. A virtual camera
shows the masks on a micromirror device and writes a photon file, as a real one would.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.camera.device import find_device
from deepfsi.counting.acquisition import Acquisition, Scene
from deepfsi.counting.recording import Recording
from deepfsi.lab.calibration import reconstruct
from deepfsi.lab.design_data import design_rails
from deepfsi.lab.virtual_optics import CAMERAS, record_scenes
from deepfsi.patterns.folder import Patterns

# %%
# Twenty non-negative masks are learned for one device and one detector, which is the camera unless
# another is given. Each mask is shown for its own share of the exposure.

digits = deepfsi.load_dataset("digits")
design = deepfsi.learn(digits, photons=1e5, masks=20, training={"epochs": 30})

# %%
# They become frames for a device of 64 × 48 mirrors. Four digits are recorded, for 10 ms each at
# 10⁷ photons per second. ``count`` finds each frame by its marker, and its photons by the frame's
# gate.

scenes, labels = digits.x_test[:4], digits.y_test[:4]
with tempfile.TemporaryDirectory() as folder:
    file = design.save(Path(folder) / "design.safetensors")
    frames, run = Path(folder) / "frames", Path(folder) / "run"
    rails = design_rails(file)
    patterns = Patterns.from_rails(rails, find_device("64x48"), 1e-3).write(frames)
    settings = Acquisition.plan(
        patterns.manifest,
        tuple(Scene(name=f"digit {k}") for k in labels),
        exposure_s=10e-3,
        repeats=1,
        flux=1e7,
        camera=CAMERAS["ideal"].model_dump(),
        seed=0,
    )
    record_scenes(run, patterns, scenes.reshape(-1, 8, 8), settings)
    recording = Recording.read(run)
    counts = recording.count()
    pictures = reconstruct(recording, counts)

# %%
# The classifier reads the counts, less the background, and the budget from the all-ON frames. Below
# the counts are least-squares pictures, with the class and its probability.

shown = design.as_shown(*patterns.realised)
signal = design.readouts(counts.signal()[:, 0])
probabilities = shown.classify(signal, counts.photons)

figure, axes = plt.subplots(3, 4, figsize=(4.8, 4.4), sharey="row", layout="constrained")
for place in range(4):
    above, middle, below = axes[:, place]
    above.imshow(scenes[place].reshape(8, 8), cmap="gray", vmin=0, vmax=1)
    above.set_title(f"a {labels[place]}")
    middle.bar(np.arange(1, 21), signal[place], width=1, color="0.4")
    middle.set(xticks=(1, 20), xlabel="mask")
    below.imshow(pictures[place], cmap="gray", vmin=0, vmax=1)
    found = probabilities[place].argmax()
    below.set_xlabel(f"a {design.classes[found]}: {probabilities[place].max():.2f}")
    for ax in (above, below):
        ax.set(xticks=[], yticks=[])
axes[0, 0].set_ylabel("scene")
axes[1, 0].set_ylabel("counts in 10 ms")
axes[2, 0].set_ylabel("from counts")
plt.show()
