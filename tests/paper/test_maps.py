"""Heat maps and contour maps: what they show is what they were given, and words can be read."""

import itertools
import math

import matplotlib
import numpy as np
import pytest
from matplotlib.collections import PathCollection, QuadMesh

from deepfsi.jobs import mask_count
from deepfsi.report.style.figures import svg
from deepfsi_paper.report import maps
from deepfsi_paper.report.scales import ON_DARK, ON_LIGHT, SEQUENTIAL
from shared.figures import assert_legible, assert_sound
from shared.results import a_point

BUDGETS = [1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8]

RATIOS = [mask_count((k / 10) ** 2, 1024) / 1024 for k in range(1, 11)]


def accuracies(seed=0, budgets=BUDGETS, ratios=RATIOS):
    rng = np.random.default_rng(seed)
    curve = 0.1 + 0.87 / (1 + np.exp(2 * (3.5 - np.log10(budgets))))
    return np.clip(
        curve - np.array(ratios)[:, None] / 10 + rng.normal(0, 0.005, (len(ratios), len(budgets))),
        0,
        1,
    )


FIGURES = {
    "heat": lambda: maps.heat_figure(
        {"truncated Hadamard": accuracies(1), "PCA": accuracies(2), "DeepFSI": accuracies(3)},
        BUDGETS,
        RATIOS,
        trained_at=1e5,
    ),
    "contour": lambda: maps.contour_figure(
        accuracies(1),
        accuracies(2),
        BUDGETS,
        RATIOS,
        ("tested with MLGauss", "tested with Poisson"),
        pixels=1024,
        apart=np.abs(accuracies(2) - accuracies(1)) > 0.01,
    ),
    "quantised": lambda: maps.contour_figure(
        accuracies(1), accuracies(2), BUDGETS, RATIOS, ("full precision", "1/768 of the peak")
    ),
}

every_figure = pytest.mark.parametrize("draw", FIGURES.values(), ids=FIGURES.keys())


@every_figure
def test_words_can_be_read(draw):
    figure = draw()
    assert figure.get_figwidth() <= 8.5
    assert_legible(figure)


@every_figure
def test_fragments_are_sound_and_settings_untouched(draw):
    assert_sound(draw)


@pytest.mark.parametrize("name", ["heat", "contour"])
def test_ink_on_colour_maps_is_not_the_pages(name):
    """The page's ink turns light on a dark page, and the map beneath does not."""
    figure = FIGURES[name]()
    inks = {ON_LIGHT, ON_DARK}
    for ax in figure.axes:
        assert {text.get_color() for text in ax.texts} <= inks
        assert {line.get_color() for line in ax.lines} <= inks
    assert all(ink in svg(figure, "a", "words") for ink in inks)


def test_grid_holds_every_point_once_and_gaps_are_nan():
    points = [
        a_point(0.9 - ratio / 50, photons=photons, ratio=ratio)
        for photons, ratio in itertools.product(BUDGETS, RATIOS[:-1])
    ]
    grid = maps.accuracy_grid(points, BUDGETS, RATIOS)
    assert np.isnan(grid[-1]).all()
    for point in points:
        place = RATIOS.index(point.ratio), BUDGETS.index(point.photons)
        assert grid[place] == point.accuracy
    with pytest.raises(ValueError, match="two points"):
        maps.accuracy_grid([*points, points[0]], BUDGETS, RATIOS)


def test_heat_maps_share_one_scale_and_one_bar():
    figure = FIGURES["heat"]()
    *panels, bar = figure.axes
    meshes = [next(c for c in ax.collections if isinstance(c, QuadMesh)) for ax in panels]
    assert len(meshes) == 3
    assert len({mesh.norm for mesh in meshes}) == 1
    assert meshes[0].get_clim() == (0.0, 1.0)
    assert bar.get_ylabel() == "accuracy (share correct)"
    assert bar.get_ylim() == (0.0, 1.0)
    for mesh, seed in zip(meshes, (1, 2, 3), strict=True):
        np.testing.assert_array_equal(mesh.get_array(), accuracies(seed))
    lightness = matplotlib.colormaps[SEQUENTIAL](np.linspace(0, 1, 50))[:, :3] @ (
        0.2126,
        0.7152,
        0.0722,
    )
    assert (np.diff(lightness) > 0).all()


def test_cells_hold_their_values_and_the_training_budget_is_framed():
    ax = FIGURES["heat"]().axes[0]
    values = accuracies(1)
    for text in ax.texts:
        x, y = text.get_position()
        value = values[int(y), round(x) - 2]
        assert text.get_text() == f"{value:.2f}".removeprefix("0")
    assert len(ax.texts) == values.size
    for frame in ax.patches:
        assert frame.get_x() < 5 < frame.get_x() + frame.get_width()
        assert frame.get_width() == pytest.approx(1)
        assert frame.get_height() == len(RATIOS)
    assert len(ax.patches) == 2


def test_cells_that_are_too_small_hold_no_values():
    budgets = [float(b) for b in np.geomspace(1e2, 1e8, 25)]
    grid = accuracies(1, budgets=budgets)
    figure = maps.heat_figure({k: grid for k in "ABC"}, budgets, RATIOS)
    assert not any(ax.texts for ax in figure.axes)
    assert_legible(figure)


def test_heat_map_without_a_training_budget_on_its_axis_has_no_frame():
    for trained_at in (None, 3e5):
        figure = maps.heat_figure({"A": accuracies()}, BUDGETS, RATIOS, trained_at)
        assert not figure.axes[0].patches
        assert "framed" not in figure.get_supxlabel()


def test_missing_cells_are_dashes():
    grid = accuracies()
    grid[2, 3] = np.nan
    ax = maps.heat_figure({"A": grid}, BUDGETS, RATIOS).axes[0]
    (dash,) = (text for text in ax.texts if text.get_text() == "–")
    assert dash.get_position() == pytest.approx((5, 2.5))


@pytest.mark.parametrize("panels", [1, 2, 4])
def test_any_number_of_heat_maps(panels):
    figure = maps.heat_figure(
        {f"design {k}": accuracies(k) for k in range(panels)}, BUDGETS, RATIOS
    )
    assert len(figure.axes) == panels + 1
    assert_legible(figure)


@pytest.mark.parametrize(
    ("budgets", "ratios"),
    [([1e4], [0.5]), ([1e4], RATIOS), (BUDGETS, [0.004]), ([1e2, 3e5], [0.1, 1])],
)
def test_small_heat_maps(budgets, ratios):
    grid = accuracies(budgets=budgets, ratios=ratios)
    assert_legible(maps.heat_figure({"DeepFSI": grid, "PCA": grid}, budgets, ratios, budgets[0]))
    assert_legible(maps.heat_figure({"PCA": grid * np.nan}, budgets, ratios, budgets[0]))


def dots_of(ax):
    return [c for c in ax.collections if isinstance(c, PathCollection)]


def test_accuracies_share_a_scale_and_the_difference_is_symmetric():
    first, second = accuracies(1), accuracies(1) - 0.03
    figure = maps.contour_figure(first, second, BUDGETS, RATIOS, ("A", "B"))
    left, middle, right, *bars = figure.axes
    assert len(bars) == 2
    scales = [
        drawn.norm
        for ax in (left, middle)
        for drawn in ax.collections
        if isinstance(drawn, PathCollection) or getattr(drawn, "filled", False)
    ]
    assert len(scales) == 4
    assert len(set(map(id, scales))) == 1
    assert scales[0].vmin <= min(first.min(), second.min())
    assert scales[0].vmax == 1
    levels = dots_of(right)[0].norm.boundaries
    np.testing.assert_allclose(levels, -levels[::-1], atol=1e-12)
    assert levels[-1] >= 0.03
    np.testing.assert_allclose(dots_of(right)[0].get_array(), -0.03)
    assert {"−0.03", "0", "+0.03"} <= {label.get_text() for label in bars[1].get_yticklabels()}
    none = dots_of(right)[0].cmap(dots_of(right)[0].norm(0.0))
    assert np.ptp(none[:3]) < 0.02
    assert [ax.get_title(loc="left") for ax in (left, middle, right)] == ["A", "B", "difference"]
    assert bars[1].get_ylabel() == "B\n− A"


@pytest.mark.parametrize("largest", [0, 1e-4, 0.012, 0.0225, 0.1, 0.47, 1])
def test_levels_of_differences_hold_all_and_never_magnify_noise(largest):
    levels = maps.difference_levels(np.array([[largest, np.nan], [-largest / 2, 0.0]]))
    np.testing.assert_allclose(levels, -levels[::-1], atol=1e-12)
    assert levels[-1] >= max(largest, 0.0125)
    assert levels[-1] <= max(2.5 * largest, 0.0125)
    assert 6 <= len(levels) <= 10


def test_line_of_dim_measurements():
    """0.1 photons per pixel and measurement: Φ / (N m) = 0.1."""
    for ax in FIGURES["contour"]().axes[:3]:
        for line in ax.lines:
            for x, y in zip(*line.get_data(), strict=True):
                assert 10**x / (1024 * 1024 * 10**y) == pytest.approx(0.1)
        assert len(ax.lines) == 2
        low, high = ax.get_xlim()
        assert low < ax.lines[0].get_xdata()[0] < ax.lines[0].get_xdata()[1] < high


def test_line_that_no_panel_holds_is_not_named():
    grid = accuracies()
    for pixels, held in ((64, True), (4, False), (10**6, False)):
        figure = maps.contour_figure(grid, grid - 0.05, BUDGETS, RATIOS, ("A", "B"), pixels=pixels)
        assert len(figure.legends) == held
        assert all(len(ax.lines) == 2 * held for ax in figure.axes[:3])


def test_triangles_point_where_the_difference_goes():
    first = np.full((2, 3), 0.5)
    second = first + np.array([[0.02, -0.02, 0.02], [-0.02, np.nan, 0.0]])
    apart = np.array([[True, True, False], [True, False, False]])
    figure = maps.contour_figure(first, second, [1e2, 1e3, 1e4], [0.1, 1], ("A", "B"), apart=apart)
    dots, up, down = dots_of(figure.axes[2])
    assert sorted(map(tuple, dots.get_offsets())) == [(4, -1), (4, 0)]
    assert sorted(map(tuple, up.get_offsets())) == [(2, -1)]
    assert sorted(map(tuple, down.get_offsets())) == [(2, 0), (3, -1)]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "difference within its 95 % interval",
        "higher, beyond that interval",
        "lower, beyond that interval",
    ]


@pytest.mark.parametrize(("largest", "panels"), [(0.0, 2), (0.0094, 2), (0.011, 3)])
def test_a_difference_too_small_to_see_is_words(largest, panels):
    first = accuracies(1)
    second = first.copy()
    second[1, 2] -= largest
    figure = maps.contour_figure(first, second, BUDGETS, RATIOS, ("A", "B"))
    assert_legible(figure)
    assert len([ax for ax in figure.axes if ax.get_title(loc="left")]) == panels
    said = [text.get_text() for key in figure.legends for text in key.get_texts()]
    bound = math.ceil(1000 * largest) / 1000
    assert said == ([f"B − A: no difference above {bound:.3f} anywhere"] if panels == 2 else [])


def test_contours_are_interpolated_between_decades():
    """Half-way between two accuracies lies half-way between two budgets, in decades."""
    grid = np.array([[0.2, 0.8], [0.2, 0.8]])
    ax = maps.contour_figure(grid, grid, [1e2, 1e6], [0.1, 1], ("A", "B")).axes[0]
    lines = next(c for c in ax.collections if hasattr(c, "allsegs") and not c.filled)
    half = lines.allsegs[list(lines.levels).index(0.5)][0]
    np.testing.assert_allclose(half[:, 0], 4)


@pytest.mark.parametrize(
    ("budgets", "ratios"),
    [
        ([1e3, 1e5], [0.1, 1]),
        ([1e4], [0.5]),
        ([1e4], RATIOS),
        (BUDGETS, [0.09]),
        ([100.0, 316.0, 1000.0], [0.01, 0.02, 0.03]),
    ],
)
@pytest.mark.parametrize("gap", [False, True])
def test_small_contour_maps_and_gaps(budgets, ratios, gap):
    first, second = (accuracies(k, budgets, ratios) for k in (1, 2))
    second -= 0.05
    if gap:
        second[0, -1] = np.nan
    figure = maps.contour_figure(first, second, budgets, ratios, ("A", "B"), pixels=64)
    assert_legible(figure)
    left, middle, right = (sum(len(d.get_offsets()) for d in dots_of(ax)) for ax in figure.axes[:3])
    assert left == first.size
    assert middle == right == first.size - gap
