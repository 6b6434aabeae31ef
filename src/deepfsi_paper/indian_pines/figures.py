"""Maps of the classes of a hyperspectral scene."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from scipy.ndimage import distance_transform_edt

from deepfsi.report import style
from deepfsi_paper.indian_pines.measures import ClassMap, Overview
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
