"""
A photon file
=============

A PicoQuant PTU file holds the arrival time of every photon, and a marker at the start of every
frame. The count of a frame is the number of photons between its marker and the next.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from deepfsi.counting.events import PtuWriter
from deepfsi.counting.reader import count_windows, read_markers, summarise

# %%
# This makes a small file to read: 24 frames of 1 ms, each with its own light, and photons at random
# times. Your file comes from the counter's own program.

rng = np.random.default_rng(0)
tick = 1e-12
frame = round(1e-3 / tick)
light = rng.uniform(50, 400, 24)
starts = frame * np.arange(24)
photons = np.concatenate(
    [
        start + rng.integers(0, frame, rng.poisson(mean))
        for start, mean in zip(starts, light, strict=True)
    ]
)
times = np.concatenate([starts, photons])
codes = np.concatenate([np.full(24, -1), np.zeros(len(photons))]).astype(np.int16)
order = np.argsort(times, kind="stable")

# %%
# ``inspect`` lists what a file contains. The times of the markers give the gates, in which the
# photons of each frame are counted.

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "photons.ptu"
    with PtuWriter(path, tick_s=tick) as writer:
        writer.write(times[order], codes[order])
    contents = summarise(path)
    marked, _ = read_markers(path)
    counts = count_windows(path, marked, marked + frame)[:, 0]
print(contents.model_dump_json(indent=1))

# %%
# Above are the photons of the first four frames (dots, at random heights so that they can be seen)
# and the markers (lines). Below are the counts of all frames, with the standard deviation √n of
# photon counts.

figure, (above, below) = plt.subplots(
    2, 1, figsize=(4.8, 4.4), height_ratios=(1, 2), layout="constrained"
)
first = photons[photons < 4 * frame] * tick * 1e3
above.plot(first, rng.uniform(0.1, 0.9, len(first)), ".", markersize=2)
above.vlines(marked[:5] * tick * 1e3, 0, 1, color="C1")
above.set(xlim=(-0.05, 4.05), ylim=(0, 1), yticks=[], xlabel="time (ms)")
above.set_title("photons and markers")
below.errorbar(range(1, 25), counts, np.sqrt(counts), fmt="o", capsize=2, label="counted")
below.stairs(light, np.arange(0.5, 25), color="0.4", linestyle=":", label="expected")
below.set(xlabel="frame", ylabel="counts", ylim=(0, None))
below.legend(ncols=2, loc="lower right", bbox_to_anchor=(1, 1))
plt.show()
