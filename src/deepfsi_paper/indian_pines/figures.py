"""Figures of a hyperspectral study: the scene, maps of its classes, masks as curves over bands."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from scipy.ndimage import distance_transform_edt

from deepfsi.camera.names import noise_text
from deepfsi.report import style
from deepfsi_paper.indian_pines.measures import ClassMap, Overview, SpectralMasks
from deepfsi_paper.report import scales

NO_CLASS = "#e9ecef"
"""Colour of pixels without a label."""

CLASS_COLOURS = (
    "#ff59a6", "#ffcca6", "#595959", "#a68059", "#008080", "#33cccc", "#cca6ff", "#cc3300",
    "#a633a6", "#0080ff", "#a6a600", "#0000ff", "#00ff00", "#593300", "#333359", "#800033",
)  # fmt: skip
"""Sixteen colours at least 20 apart by CIEDE2000, and 10 to eyes without red or green cones.

Maps number their classes all the same.
"""

USES = (
    (NO_CLASS, "no label"),
    ("#9ec9e6", "training"),
    ("#cc5500", "test"),
    (scales.ON_LIGHT, "left out beside test"),
)
"""Colour and name of each use of a pixel, in the order of their numbers."""

USE_MAP = ListedColormap([colour for colour, _ in USES])

MAPS_WIDTH = 9.6
"""Width of the class maps, inches."""

WIDE = 4.0
"""Steps of wavelength, over the median, that are a gap of left out bands."""

LOOKS: tuple[dict[str, Any], ...] = (
    {"color": style.DESIGN_COLOURS["pca"], "linestyle": "-"},
    {"color": style.DESIGN_COLOURS["deepfsi"], "linestyle": (0, (5, 1.6))},
    {"color": style.INK, "linestyle": (0, (1.2, 1.2))},
    {"color": style.DESIGN_COLOURS["truncated-hadamard"], "linestyle": (0, (6, 1.6, 1.2, 1.6))},
)
"""Colours and dashes of spectra and of spectral masks."""


@style.styled
def overview_figure(scene: Overview, *, title: str, band_name: str) -> Figure:
    """One band of a scene, its classes, how many pixels each has, and spectra of some."""
    labels = scene.labels.values
    figure = Figure(figsize=(style.PAGE_WIDTH, 6.4), layout="constrained")
    figure.suptitle(title, fontsize=10, fontweight="bold")
    panels = figure.subplots(2, 2, height_ratios=(1.15, 1))
    band = panels[0, 0]
    band.imshow(scene.band.values, cmap=style.GREYS, interpolation="none")
    band.set_title(band_name)
    _bare(band)
    classes = panels[0, 1]
    _class_map(classes, labels)
    classes.set_title("classes")
    _number_fields(classes, labels, len(scene.classes))
    _count_pixels(panels[1, 0], labels, scene.classes)
    _draw_spectra(panels[1, 1], scene)
    return figure


@style.styled
def class_maps_figure(
    scene: Overview, rows: Sequence[ClassMap], uses: Mapping[str, np.ndarray], *, title: str
) -> Figure:
    """Maps of predicted classes, a row for each split, beside the truth and the test pixels."""
    truth, names = scene.labels.values, scene.classes
    budgets = sorted({row.photons for row in rows})
    columns = 2 + len(budgets)
    height = len(uses) * (MAPS_WIDTH / columns + 0.25) + 0.16 * -(-len(names) // 5) + 0.6
    figure = Figure(figsize=(MAPS_WIDTH, height), layout="constrained")
    figure.suptitle(title, fontsize=10, fontweight="bold")
    panels = figure.subplots(len(uses), columns, squeeze=False)
    for line, (split, use) in zip(panels, uses.items(), strict=True):
        _class_map(line[0], truth)
        line[0].set_title("truth")
        line[1].imshow(use, cmap=USE_MAP, vmin=0, vmax=len(USES) - 1, interpolation="none")
        line[1].set_title(f"{split} split")
        _bare(line[1])
        for ax, photons in zip(line[2:], budgets, strict=True):
            _bare(ax)
            for row in rows:
                if (row.split, row.photons) == (split, photons):
                    _class_map(ax, row.map.values)
                    ax.set_title(
                        f"{style.photons_text(photons)} photons\n"
                        f"test {row.test:.2f}, training {row.train:.2f}",
                        fontsize=8,
                    )
    _number_fields(panels[0, 0], truth, len(names))
    classes = [
        Patch(facecolor=colour, edgecolor=style.INK, linewidth=0.4, label=f"{number} {name}")
        for number, (colour, name) in enumerate(zip(CLASS_COLOURS, names, strict=False), start=1)
    ]
    parts = [Patch(facecolor=colour, label=f"pixels: {name}") for colour, name in USES]
    figure.legend(
        handles=[*classes, *parts], loc="outside lower center", ncols=5, frameon=False,
        fontsize=style.SMALL, handlelength=1.2, handleheight=0.9,
    )  # fmt: skip
    return figure


@style.styled
def spectral_masks_figure(rows: Sequence[SpectralMasks], scene: Overview, *, title: str) -> Figure:
    """Masks learned under both noises as curves over wavelength, by photon budget.

    Each panel has a scale of its own.
    """
    figure = Figure(figsize=(style.PAGE_WIDTH, 0.7 + 1.6 * len(rows)), layout="constrained")
    figure.suptitle(title, fontsize=10, fontweight="bold")
    panels = figure.subplots(len(rows), len(scales.AXIS_NOISES), squeeze=False, sharex=True)
    for line, row in zip(panels, rows, strict=True):
        kinds = {
            "gaussian": (row.gaussian, row.gaussian_masks),
            "poisson": (row.poisson, row.poisson_masks),
        }
        for ax, noise in zip(line, scales.AXIS_NOISES, strict=True):
            curves, masks = np.array(kinds[noise][0]), kinds[noise][1]
            x, order = _bands(scene.wavelengths, curves.shape[1])
            for mask, look in zip(curves, LOOKS, strict=False):
                ax.plot(x, _broken(x, mask[order]), linewidth=1.1, **look)
            ax.axhline(0, color=style.MUTED, linewidth=0.6)
            count = min(len(curves), len(LOOKS))
            ax.set_title(
                f"{style.photons_text(row.photons)} photons, {noise_text(noise)}: "
                f"{count} of {masks} masks",
                fontsize=style.SMALL + 0.5,
            )
            ax.set_xlim(x[0], x[-1])
    figure.supxlabel(_band_label(scene), fontsize=9)
    figure.supylabel("share of a band's photons, Mᵢⱼ", fontsize=9)
    return figure


def _count_pixels(ax: Axes, labels: np.ndarray, names: Sequence[str]) -> None:
    """Draw a bar of each class's labelled pixels."""
    places = np.arange(1, len(names) + 1)
    counts = np.bincount(labels.ravel(), minlength=len(names) + 1)[1:]
    ax.barh(places, counts, color=CLASS_COLOURS[: len(names)], edgecolor=style.INK, linewidth=0.4)
    ax.set_yticks(places, [f"{k} {name}" for k, name in zip(places, names, strict=True)])
    ax.tick_params(axis="y", labelsize=style.SMALL, length=0)
    ax.set_ylim(len(names) + 0.6, 0.4)
    ax.set_xlim(0, 1.2 * counts.max())
    for place, count in zip(places, counts, strict=True):
        ax.annotate(
            str(count), (count, place), (3, 0), textcoords="offset points",
            verticalalignment="center", fontsize=style.SMALL,
        )  # fmt: skip
    ax.set_xlabel("labelled pixels")


def _draw_spectra(ax: Axes, scene: Overview) -> None:
    """Draw the median spectrum of some classes, and the range of most pixels."""
    x, order = _bands(scene.wavelengths, scene.bands)
    for (name, percentiles), look in zip(scene.spectra.items(), LOOKS, strict=False):
        low, middle, high = np.array(percentiles)[:, order]
        ax.fill_between(x, _broken(x, low), high, color=look["color"], alpha=0.2, linewidth=0)
        ax.plot(x, _broken(x, middle), label=name, linewidth=1.2, **look)
    ax.set_ylim(bottom=0)
    ax.set_xlim(x[0], x[-1])
    ax.legend(frameon=False, fontsize=style.SMALL)
    ax.set_xlabel(_band_label(scene))
    ax.set_ylabel("value, scaled to [0, 1]")


def _bands(wavelengths: Sequence[float] | None, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Places of bands on an axis, rising, and the order of the bands."""
    if wavelengths is None:
        return np.arange(1, count + 1), np.arange(count)
    order = np.argsort(wavelengths, kind="stable")
    return np.array(wavelengths)[order], order


def _broken(x: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """A curve that ends before bands that are left out: NaN where the next one is far."""
    steps = np.diff(x)
    ends = np.append(steps > WIDE * np.median(steps), False)
    return np.where(ends, np.nan, curve)


def _band_label(scene: Overview) -> str:
    return "band" if scene.wavelengths is None else "wavelength (nm)"


def _bare(ax: Axes) -> None:
    ax.set(xticks=[], yticks=[])
    ax.spines[:].set_visible(False)


def _class_map(ax: Axes, labels: np.ndarray) -> None:
    colours = ListedColormap([NO_CLASS, *CLASS_COLOURS])
    ax.imshow(labels, cmap=colours, vmin=0, vmax=len(CLASS_COLOURS), interpolation="none")
    _bare(ax)


def _number_fields(ax: Axes, labels: np.ndarray, classes: int) -> None:
    """Write each class's number where its largest field is widest."""
    for number in range(1, classes + 1):
        depth = distance_transform_edt(np.pad(labels == number, 1))[1:-1, 1:-1]
        if depth.any():
            y, x = np.unravel_index(depth.argmax(), depth.shape)
            text = ax.text(x, y, str(number), fontsize=style.SMALL, color=scales.ON_LIGHT)
            text.set(horizontalalignment="center", verticalalignment="center")
            text.set_path_effects([withStroke(linewidth=1.5, foreground=scales.ON_DARK)])
