"""Heat maps: what they show is what they were given, and words can be read."""

import itertools

import numpy as np
import pytest

from deepfsi.jobs.designs import DESIGNS as CODES
from deepfsi.jobs.designs import mask_count
from deepfsi.report import style
from deepfsi_paper.camera import figures
from deepfsi_paper.report import maps
from shared.figures import assert_legible, assert_sound
from shared.results import a_point

BUDGETS = [1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8]
RATIOS = [mask_count((k / 10) ** 2, 1024) / 1024 for k in range(1, 11)]
GRID = (BUDGETS, RATIOS)


def accuracies(seed):
    curve = 0.1 + 0.87 / (1 + np.exp(2 * (3.5 - np.log10(BUDGETS))))
    spread = np.random.default_rng(seed).normal(0, 0.005, (len(RATIOS), len(BUDGETS)))
    return np.clip(curve - np.array(RATIOS)[:, None] / 10 + spread, 0, 1)


MAPS = {name: accuracies(k) for k, name in enumerate(("truncated Hadamard", "PCA", "DeepFSI"), 1)}
FIRST, SECOND, _ = MAPS.values()


def both(first, second, apart=0.01):
    """Two tests whose intervals are as wide as `apart` to both sides."""
    points = [
        [
            a_point(accuracy, apart / 2**0.5, photons=photons, ratio=ratio, accuracies=(accuracy,))
            for ratio, row in zip(RATIOS, grid, strict=False)
            for photons, accuracy in zip(BUDGETS, row, strict=False)
        ]
        for grid in (first, second)
    ]
    return maps.pair(*points)


FIGURES = {
    "heat": lambda: maps.heat_figure(MAPS, *GRID, trained_at=1e5),
    "difference": lambda: maps.difference_figure(both(FIRST, SECOND), ("MLGauss", "Poisson")),
}


@pytest.mark.usefixtures("drawn_once")
@pytest.mark.parametrize("draw", FIGURES.values(), ids=FIGURES)
def test_words_can_be_read_and_fragments_are_sound(draw):
    figure = draw()
    assert figure.get_figwidth() <= 8.5
    assert_legible(figure)
    assert_sound(draw)


def test_grid_holds_every_point_once_and_gaps_are_nan():
    points = [
        a_point(0.9 - ratio / 50, photons=photons, ratio=ratio)
        for photons, ratio in itertools.product(BUDGETS, RATIOS[:-1])
    ]
    grid = maps.accuracy_grid(points, *GRID)
    assert np.isnan(grid[-1]).all()
    for point in points:
        assert grid[RATIOS.index(point.ratio), BUDGETS.index(point.photons)] == point.accuracy


def test_cells_hold_their_values_and_the_training_budget_is_framed():
    ax = FIGURES["heat"]().axes[0]
    for text in ax.texts:
        x, y = text.get_position()
        assert text.get_text() == f"{FIRST[int(y), round(x) - 2]:.2f}".removeprefix("0")
    assert len(ax.texts) == FIRST.size
    assert len(ax.patches) == 2
    for frame in ax.patches:
        assert frame.get_x() < 5 < frame.get_x() + frame.get_width()
        assert frame.get_width() == pytest.approx(1)
        assert frame.get_height() == len(RATIOS)


def test_differences_beyond_their_intervals_stand_in_their_cells():
    first = np.full((2, 3), 0.5)
    second = first + np.array([[0.02, -0.02, 0.004], [-0.13, 0.0, 0.0]])
    figure = maps.difference_figure(both(first, second), ("A", "B"))
    words = [text.get_text() for text in figure.axes[2].texts]
    assert words == ["+2", "−2", "", "−13", "", ""]
    mesh = figure.axes[2].collections[0]
    np.testing.assert_allclose(mesh.get_array().ravel(), (second - first).ravel(), atol=1e-12)
    assert mesh.get_clim() == pytest.approx((-0.13, 0.13))


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
