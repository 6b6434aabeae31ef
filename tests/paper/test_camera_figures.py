"""Figures of the camera: what they show is what they were given, and all words can be read."""

import numpy as np
import pytest

from deepfsi.jobs.designs import DESIGNS as CODES
from deepfsi.report import style
from deepfsi_paper.camera import figures
from shared.figures import assert_legible

SHOWN = ("deepfsi", "pca", "truncated-hadamard", "raster", "hadamard")
TITLES = {**{design: CODES[design].title for design in SHOWN}, "deepfsi": "DeepFSI, equal dwell"}
LABELS = [CODES[design].label for design in SHOWN]
EXPOSURES = (1e-4, 1e-3, 1e-2, 1e-1)


def points(reach=0.03, offset=0.0):
    made = []
    for place, design in enumerate(SHOWN):
        name = (design, CODES[design].label, TITLES[design], CODES[design].specific)
        for step, exposure in enumerate(EXPOSURES):
            accuracy = 0.3 + 0.2 * step - 0.05 * place + offset
            numbers = (accuracy, accuracy - reach, accuracy + reach)
            made.append(figures.Accuracy(*name, exposure, *numbers))
    return made


def test_exposures_have_lines_and_published_values_open_beside():
    published = points(0.15, -0.08)
    figure = figures.exposure_figure(points(), published, flux=1e7)
    assert_legible(figure)
    ax = figure.axes[0]
    ours = [bars for bars in ax.containers if bars.get_label() == TITLES["deepfsi"]]
    np.testing.assert_allclose(ours[0].lines[0].get_ydata(), [0.3, 0.5, 0.7, 0.9])
    hollow = [line for line in ax.get_lines() if line.get_markerfacecolor() == style.PAPER]
    alone = [line for line in hollow if len(line.get_ydata()) == 1]
    for line, point in zip(alone, published, strict=True):
        assert line.get_ydata()[0] == pytest.approx(point.accuracy)
        assert point.exposure_s < line.get_xdata()[0] < 2 * point.exposure_s
        assert line.get_marker() == ("o" if point.specific else "s")
        assert line.get_color() == style.DESIGN_COLOURS[point.design]
    (top,) = ax.child_axes
    assert [tick.get_text() for tick in top.get_xticklabels()] == ["10³", "10⁴", "10⁵", "10⁶"]
