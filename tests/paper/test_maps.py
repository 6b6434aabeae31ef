"""Heat maps: what they show is what they were given, and words can be read."""

import itertools

import numpy as np
import pytest

from deepfsi.jobs.designs import mask_count
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
