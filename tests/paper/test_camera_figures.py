"""Figures of the camera: what they show is what they were given, and all words can be read."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import QuadMesh

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
    ours = [line for line in ax.get_lines() if line.get_label() == TITLES["deepfsi"]]
    np.testing.assert_allclose(ours[0].get_ydata(), [0.3, 0.5, 0.7, 0.9])
    hollow = [line for line in ax.get_lines() if line.get_markerfacecolor() == style.PAPER]
    alone = [line for line in hollow if len(line.get_ydata()) == 1]
    for line, point in zip(alone, published, strict=True):
        assert line.get_ydata()[0] == pytest.approx(point.accuracy)
        assert point.exposure_s < line.get_xdata()[0] < 2 * point.exposure_s
        assert line.get_marker() == ("o" if point.specific else "s")
        assert line.get_color() == style.DESIGN_COLOURS[point.design]
    (top,) = ax.child_axes
    assert [tick.get_text() for tick in top.get_xticklabels()] == ["10³", "10⁴", "10⁵", "10⁶"]


def test_squares_have_the_success_rate_as_grey_and_as_number():
    rng = np.random.default_rng(0)
    panels = {f"{exposure:g} s": rng.random((5, 10)) for exposure in EXPOSURES}
    panels["0.1 s"][2, 3] = np.nan
    panels["0.1 s"][0] = 1
    classes = [str(digit) for digit in range(10)]
    figure = figures.digits_figure(panels, LABELS, classes)
    assert_legible(figure)
    for ax, (heading, rates) in zip(figure.axes, panels.items(), strict=False):
        assert ax.get_title(loc="left") == heading
        (mesh,) = (c for c in ax.collections if isinstance(c, QuadMesh))
        shown = np.ma.filled(mesh.get_array(), np.nan).reshape(5, 10)
        np.testing.assert_allclose(shown, 100 * rates)
        assert mesh.get_clim() == (0, 100)
        words = [text.get_text() for text in ax.texts]
        assert words == ["–" if np.isnan(rate) else f"{100 * rate:.0f}" for rate in rates.ravel()]
        assert ax.get_ylim() == (5, 0)


AXES = {
    "ambient": "ambient light (photons/s on the device)",
    "dead_time_s": "dead time (s)",
    "assumed": "budget assumed in training (photons)",
    "unused": "what nobody varied",
}
VALUES = {
    "ambient": (0.0, 1e5, 3e5, 1e6, 1e7),
    "dead_time_s": (0.0, 20e-9, 50e-9, 200e-9),
    "assumed": (1e3, 1e4, 1e5),
}


def test_effects_have_a_column_each_and_exposures_a_row():
    shown = [replace(p, accuracy=0.5) for p in points() if p.exposure_s in (1e-3, 1e-2)]
    rows = [
        replace(point, effect=effect, value=value, low=0.4, high=0.6 + place / 50)
        for effect, values in VALUES.items()
        for place, value in enumerate(values)
        for point in shown
    ]
    figure = figures.effects_figure(rows, AXES, flux=1e7)
    assert_legible(figure)
    heads = [ax.get_title(loc="left") for ax in figure.axes]
    wanted = {0: "exposure 0.01 s, 10⁵ photons", 3: "exposure 0.001 s, 10⁴ photons"}
    assert {place: head for place, head in enumerate(heads) if head} == wanted
    axes = dict(zip(VALUES, figure.axes, strict=False))
    ambient = axes["ambient"].containers
    assert len(ambient) == len(SHOWN)
    np.testing.assert_allclose(ambient[0].lines[0].get_xdata(orig=False)[1:], VALUES["ambient"][1:])
    dead = axes["dead_time_s"].containers[0].lines[0].get_xdata(orig=False)
    np.testing.assert_allclose(dead[1:], [20, 50, 200])
    assert 0 < dead[0] < 20
    ticks = [tick.get_text() for tick in figure.axes[4].get_xticklabels()]
    assert ticks == ["0", "20", "50", "200"]
    assert figure.axes[4].get_xlabel() == "dead time (ns)"
    marks = [axes[effect].get_lines()[-1].get_xdata()[0] for effect in ("ambient", "assumed")]
    assert marks == [1e7, 1e5]
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == [*TITLES.values(), figures.MARKS]  # the dotted lines are explained
    breaks = [line for line in axes["ambient"].get_lines() if line.get_ydata()[0] == 0]
    assert len(breaks) >= 3  # 0 is not on the logarithmic scale
    assert not [line for line in axes["assumed"].get_lines()[:-1] if line.get_ydata()[0] == 0]
