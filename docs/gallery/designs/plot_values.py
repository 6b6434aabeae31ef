"""
Estimate values: how much of each material
==========================================

A pixel of a hyperspectral image often holds several materials. Its spectrum is the sum of theirs,
each weighted by its *abundance*, and a camera of few photons is asked for the abundances, not for
the spectrum. Give values as floats in place of labels, and masks are learned that estimate them.
"""

import matplotlib.pyplot as plt
import numpy as np

import deepfsi
from deepfsi.design.bounds import cramer_rao
from deepfsi.report.style import COLOURS, STYLE, photons_text

plt.rcParams.update(STYLE)

# %%
# Three materials of 64 bands, mixed at random. The abundances of one pixel sum to 1, so that two of
# them say all.

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
# Designs of one DMD and one detector, each trained at the budget that it is tested at. `evaluate`
# gives the root mean squared error of each value, in its own unit.

budgets = (1e3, 1e4, 1e5, 1e6)
designs = {"raster": 64, "pca": 4, "deepfsi": 4}
errors: dict[str, list[float]] = {name: [] for name in designs}
bounds = []
slopes = np.stack([materials[0] - materials[2], materials[1] - materials[2]])
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
    every = cramer_rao(design, data.x_test, np.broadcast_to(slopes, (800, 2, 64)), photons)
    bounds.append(float(np.sqrt((every**2).mean(axis=0)).mean()))

# %%
# The *Cramér–Rao bound* is the least error of an estimator of these counts that is right in the
# mean. A network that has seen the abundances of the training is not: with little light it answers
# close to their mean, and its error is below the bound. With more light the two meet. At 10⁶
# photons the learned masks are above the bound, and behind PCA: so short a training does not find
# what so much light allows.

figure, ax = plt.subplots(figsize=(6.4, 4), layout="constrained")
titles = {"raster": "raster scan, 64 bands", "pca": "PCA, 4 masks", "deepfsi": "learned, 4 masks"}
for name, values in errors.items():
    ax.plot(budgets, values, "o-", color=COLOURS[name], label=titles[name])
ax.plot(budgets, bounds, ":", color="0.4", label="Cramér–Rao bound of the learned masks")
spread = float(data.y_test.std(axis=0).mean())
ax.axhline(spread, color="0.6", linewidth=0.9, linestyle="--", label="answering the mean")
ax.set(xscale="log", yscale="log", xlabel="photon budget Φ", ylabel="RMS error of an abundance")
ax.set_xticks(budgets, [photons_text(photons) for photons in budgets])
ax.set_yticks([0.01, 0.1], ["0.01", "0.1"])
ax.minorticks_off()
ax.grid(alpha=0.3)
ax.legend(frameon=False, loc="lower left")
plt.show()
