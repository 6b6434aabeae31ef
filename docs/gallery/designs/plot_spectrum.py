"""
A spectrum
==========

Spectra are scenes of one axis: a mask is a transmission curve. Three dyes whose absorption bands
overlap are told apart from the counts behind four such masks.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.report.style import STYLE, photons_text

plt.rcParams.update(STYLE)

# %%
# Made-up transmission spectra in 64 bands: each dye absorbs around a wavelength of its own, by an
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
# Learned at 1000 photons, for optics that split the light of each band among all masks. Positive
# values are counted on the first rail, negative ones on the second; the network reads the
# difference.

design = deepfsi.learn(data, camera="paper", photons=1e3, masks=4, training={"epochs": 30})
results = deepfsi.evaluate(design, data, [1e2, 1e3, 1e4, 1e5])
for result in results:
    print(f"{photons_text(result.photons)} photons: accuracy {result.accuracy:.3f}")

figure, (above, below) = plt.subplots(2, 1, figsize=(6.4, 5.4), sharex=True, layout="constrained")
colours = ("#0072b2", "#d55e00", "#009e73")
for name, colour, line in zip(centres, colours, ("-", "--", "-."), strict=True):
    low, middle, high = np.quantile(x[y == name], (0.1, 0.5, 0.9), axis=0)
    above.fill_between(bands, low, high, color=colour, alpha=0.15, linewidth=0)
    above.plot(bands, middle, line, color=colour, label=name)
above.set(ylabel="transmission", ylim=(0, 1), title="scenes: median, and 10 % to 90 %")
above.legend(loc="lower left")
for place, mask in enumerate(design.matrix):
    colour, line = (
        ("#1b1f24", "#e69f00", "#56b4e9", "#cc79a7")[place],
        ("-", "--", "-.", ":")[place],
    )
    below.step(bands, mask, line, where="mid", color=colour, label=f"mask {place + 1}")
below.axhline(0, color="0.6", linewidth=0.8)
below.legend(ncols=2)
found = results[1]
below.set(xlabel="wavelength, nm", ylabel="share of each band's light")
below.set_title(
    f"accuracy {found.accuracy:.2f} [{found.low:.2f}, {found.high:.2f}] at 1000 photons"
)
figure.supxlabel("95 % interval over 300 test spectra, for this trained design", fontsize=9)
plt.show()
