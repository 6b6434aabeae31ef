"""
A spectrum
==========

Three dyes with overlapping absorption bands are told apart by the counts behind four masks. A
spectrum is a scene with one axis, and a mask is then a transmission curve.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.report.style import photons_text

# %%
# The spectra are invented, in 64 bands. Each dye absorbs around a wavelength of its own, by an
# amount that differs from sample to sample.

rng = np.random.default_rng(0)
bands = np.linspace(450, 650, 64)
centres = {"dye A": 535, "dye B": 545, "dye C": 557}
y = rng.choice(list(centres), 1500)
centre = np.array([centres[name] for name in y])
depth, width = rng.uniform(0.3, 0.8, (1500, 1)), rng.uniform(25, 35, (1500, 1))
x = 0.9 - depth * np.exp(-(((bands - centre[:, None]) / width) ** 2))
data = deepfsi.from_arrays(x, y, name="dyes")

# %%
# The masks are learned at 1000 photons, for optics that split the light of each band among all
# masks. Positive values are counted on the first rail, negative ones on the second, and the network
# reads the difference. The script prints accuracies with 95 % intervals over 300 test spectra, for
# this trained design.

design = deepfsi.learn(data, camera="paper", photons=1e3, masks=4, training={"epochs": 30})
results = deepfsi.evaluate(design, data, [1e2, 1e3, 1e4, 1e5])
for result in results:
    interval = f"[{result.low:.3f}, {result.high:.3f}]"
    print(f"{photons_text(result.photons)} photons: accuracy {result.accuracy:.3f} {interval}")

figure, axes = plt.subplots(5, 1, figsize=(4.8, 6.4), sharex=True, height_ratios=(3, 1, 1, 1, 1))
above, *rows = axes
for name, line in zip(centres, ("-", "--", "-."), strict=True):
    low, middle, high = np.quantile(x[y == name], (0.1, 0.5, 0.9), axis=0)
    [median] = above.plot(bands, middle, line, label=name)
    above.fill_between(bands, low, high, color=median.get_color(), alpha=0.15, linewidth=0)
above.set(ylabel="transmission", ylim=(0, 1), title="dyes: median, and 10 % to 90 %")
above.legend(loc="lower left")
for place, (ax, mask) in enumerate(zip(rows, design.matrix, strict=True)):
    ax.fill_between(bands, mask, step="mid", color="0.4", linewidth=0)
    ax.axhline(0, color="0.6", linewidth=0.8)
    ax.set(ylim=(-1.1, 1.1), ylabel=f"mask {place + 1}")
rows[0].set_title("masks: share of each band's light")
rows[-1].set_xlabel("wavelength (nm)")
figure.set_layout_engine("constrained")
plt.show()
