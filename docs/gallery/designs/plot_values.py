"""
Estimate values: how much of each material
==========================================

Give values as floats in place of labels, and the masks are learned to estimate them. Here the
values are *abundances*: how much of each material a pixel of a hyperspectral image holds. Its
spectrum is the sum of the materials' spectra, each weighted by its abundance.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.report.style import DESIGN_COLOURS, photons_text

# %%
# Three materials with spectra of 64 bands are mixed at random. The abundances of a pixel sum to 1,
# so two of them are enough.

bands = np.linspace(0, 1, 64)
materials = np.stack(
    [
        0.45 + 0.25 * np.sin(5 * bands),
        0.30 + 0.40 * np.exp(-(((bands - 0.7) / 0.12) ** 2)),
        0.55 - 0.30 * np.exp(-(((bands - 0.35) / 0.10) ** 2)),
    ]
)
shares = np.random.default_rng(0).dirichlet([1, 1, 1], 4000).astype(np.float32)
spectra = shares @ materials
data = deepfsi.from_arrays(spectra, shares[:, :2], values=["first", "second"], name="mixtures")
print(data)

# %%
# Designs for one DMD and one detector, each trained at the budget that it is tested at.
# ``evaluate`` gives the root mean squared error of each value, in the unit of that value.

budgets = (1e3, 1e4, 1e5, 1e6)
designs = {"raster": 64, "pca": 4, "deepfsi": 4}
errors: dict[str, list[float]] = {name: [] for name in designs}
for photons in budgets:
    for name, masks in designs.items():
        design = deepfsi.learn(
            data,
            design=name,
            camera="dmd",
            photons=photons,
            masks=masks,
            training=deepfsi.Training(epochs=30),
        )
        [result] = deepfsi.evaluate(design, data, photons)
        errors[name].append(float(np.mean(result.rmse)))

# %%
# At 10⁶ photons the error of the learned masks is above that of PCA: so short a training does not
# reach what so much light allows.

figure, ax = plt.subplots(figsize=(4.8, 4.4), layout="constrained")
titles = {"raster": "raster scan, 64 bands", "pca": "PCA, 4 masks", "deepfsi": "learned, 4 masks"}
for name, values in errors.items():
    ax.plot(budgets, values, "o-", color=DESIGN_COLOURS[name], label=titles[name])
spread = float(data.y_test.std(axis=0).mean())
ax.axhline(spread, color="0.6", linewidth=0.9, linestyle="--", label="always the mean")
ax.set(xscale="log", yscale="log", xlabel="photon budget", ylabel="RMS error of an abundance")
ax.set_xticks(budgets, [photons_text(photons) for photons in budgets])
ax.set_yticks([0.01, 0.1], ["0.01", "0.1"])
ax.minorticks_off()
ax.legend(loc="lower left")
plt.show()
