"""Figures of the study: what they show is what they were given, and all words can be read."""

from __future__ import annotations

import itertools
import math
import xml.etree.ElementTree as ElementTree

import matplotlib
import numpy as np
import pytest
from matplotlib.collections import PathCollection, QuadMesh
from matplotlib.text import Annotation

from deepfsi.errors import InputError
from deepfsi.optics import codes
from deepfsi.optics.budget import impulse_imaging_error
from deepfsi.report import maps
from deepfsi.report.figures import svg

BUDGETS = [1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8]
RATIOS = [codes.mask_count((k / 10) ** 2, 1024) / 1024 for k in range(1, 11)]
DESIGNS = ("impulse", "raster", "hadamard", "truncated-hadamard", "pca", "deepfsi", "control")


def words(figure):
    """Texts that are drawn, with their boxes in pixels."""
    figure.draw_without_rendering()
    found = [*figure.texts]
    for legend in figure.legends:
        found += legend.get_texts()
    for ax in figure.axes:
        found += [*ax.texts, ax.title, ax._left_title, ax._right_title]
        for axis in (ax.xaxis, ax.yaxis):
            low, high = sorted(axis.get_view_interval())
            margin = 1e-6 * abs(high - low)
            found.append(axis.label)
            for tick in axis.get_major_ticks():
                if low - margin <= tick.get_loc() <= high + margin:
                    found += [tick.label1, tick.label2]
    shown = [text for text in found if text.get_visible() and text.get_text()]
    return [(text, text.get_window_extent()) for text in shown]


def assert_legible(figure, smallest=6.5):
    """No text touches another, leaves the figure, or is smaller than print allows (points)."""
    drawn = words(figure)
    assert len(drawn) > 5
    edge = figure.bbox
    for text, box in drawn:
        assert text.get_fontsize() >= smallest, text.get_text()
        assert box.x0 >= -0.5, text.get_text()
        assert box.y0 >= -0.5, text.get_text()
        assert box.x1 <= edge.x1 + 0.5, text.get_text()
        assert box.y1 <= edge.y1 + 0.5, text.get_text()
    low, high = (np.array([getattr(box, corner) for _, box in drawn]) for corner in ("min", "max"))
    shared = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
    touching = np.argwhere(np.triu((shared >= 1).all(axis=2), 1))
    assert not [(drawn[a][0].get_text(), drawn[b][0].get_text()) for a, b in touching]


def results_of(noises=("poisson", "gaussian"), budgets=BUDGETS, designs=DESIGNS, ratios=RATIOS):
    points = []
    for noise, (place, design), photons in itertools.product(noises, enumerate(designs), budgets):
        code = codes.DESIGNS[design]
        own = [1.0] if code.fixed_count else ratios
        for ratio in own:
            middle = 3 + 0.3 * place + (noise == "gaussian")
            accuracy = 0.1 + 0.87 / (1 + math.exp(2 * (middle - math.log10(photons)))) - ratio / 50
            points.append(
                {
                    "design": design,
                    "label": code.label,
                    "specific": code.specific,
                    "noise": noise,
                    "light": "column",
                    "rails": "dual",
                    "photons": photons,
                    "masks": round(1024 * ratio),
                    "ratio": ratio,
                    "accuracy": accuracy,
                    "low": accuracy - 0.01,
                    "high": accuracy + 0.02,
                    "best": ratio == own[0],
                }
            )
    return {
        "recipe": {"sigma": 2.0},
        "data": {
            "classes": [str(k) for k in range(10)],
            "image_shape": [32, 32],
            "mean_reflectance": 0.37,
        },
        "chosen_on": "validation",
        "points": points,
    }


def accuracies(seed=0, budgets=BUDGETS, ratios=RATIOS):
    rng = np.random.default_rng(seed)
    curve = 0.1 + 0.87 / (1 + np.exp(2 * (3.5 - np.log10(budgets))))
    return np.clip(
        curve - np.array(ratios)[:, None] / 10 + rng.normal(0, 0.005, (len(ratios), len(budgets))),
        0,
        1,
    )


def mask_rows(budgets=(1e3, 1e5, 1e8), shape=(6, 4), counts=(9, 7)):
    rng = np.random.default_rng(0)
    return [
        {
            "photons": photons,
            "image_shape": shape,
            "gaussian": rng.normal(size=(counts[0], math.prod(shape))) / 7,
            "poisson": rng.normal(size=(counts[1], math.prod(shape))) ** 3 / 50,
        }
        for photons in budgets
    ]


def measure_rows(budgets=BUDGETS):
    rows = []
    for photons in budgets:
        for series, value in (("gaussian", 0.9), ("poisson", 0.4)):
            point = {"series": series, "photons": photons}
            rows.append({**point, "measure": "light throughput", "value": value})
            rows.append({**point, "measure": "effective number of directions", "value": 30 * value})
        for series, value in (("AGN with PN", 0.6), ("random masks", 0.04)):
            point = {"series": series, "photons": photons}
            rows.append({**point, "measure": "subspace similarity", "value": value})
    return [{**row, "low": 0.9 * row["value"], "high": 1.1 * row["value"]} for row in rows]


def starts_of(noises=("poisson",), budgets=BUDGETS, ends=True):
    starts = {"pca": 0.0, "truncated-hadamard": -0.01, "random": -0.06}
    points, differences = [], []
    for noise, photons, (start, loss) in itertools.product(noises, budgets, starts.items()):
        accuracy = 0.2 + 0.09 * math.log10(photons) + loss
        at = {"noise": noise, "photons": photons, "start": start}
        points.append({**at, "accuracy": accuracy, "low": accuracy - 0.01, "high": accuracy + 0.01})
        if loss:
            low, high = (loss - 0.004, loss + 0.004) if ends else (None, None)
            differences.append({**at, "difference": loss, "low": low, "high": high})
    return {
        "points": points,
        "differences": differences,
        "data": {"classes": [str(k) for k in range(10)]},
    }


FIGURES = {
    "error": lambda: maps.error_figure(results_of()),
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
    "masks": lambda: maps.masks_table_figure(mask_rows()),
    "patch-masks": lambda: maps.patch_masks_figure(patch_rows()),
    "measures": lambda: maps.measures_figure(measure_rows()),
    "starts": lambda: maps.starts_figure(starts_of()),
    "both starts": lambda: maps.starts_figure(starts_of(("gaussian", "poisson"))),
}
every_figure = pytest.mark.parametrize("draw", FIGURES.values(), ids=FIGURES.keys())


@every_figure
def test_words_can_be_read(draw):
    figure = draw()
    assert figure.get_figwidth() <= 8.5
    assert_legible(figure)


def test_the_check_on_words_sees_what_it_must():
    figure = FIGURES["measures"]()
    assert_legible(figure)
    figure.axes[0].set_title("a heading that is so long that it runs into its neighbour's")
    with pytest.raises(AssertionError):
        assert_legible(figure)
    figure = FIGURES["masks"]()
    figure.text(0.99, 0.5, "beyond the edge")
    with pytest.raises(AssertionError, match="beyond the edge"):
        assert_legible(figure)


@every_figure
def test_fragments_are_sound_and_settings_untouched(draw):
    before = dict(matplotlib.rcParams)
    text = svg(draw(), "a", "words")
    assert dict(matplotlib.rcParams) == before
    root = ElementTree.fromstring(text)
    ids = [element.get("id") for element in root.iter() if element.get("id")]
    assert len(ids) == len(set(ids))
    links = [element.get("href") for element in root.iter() if element.get("href")]
    assert all(link[1:] in ids or link.startswith("data:image/png;base64,") for link in links)
    assert text == svg(draw(), "a", "words")


def test_mask_images_are_inside_the_fragment():
    root = ElementTree.fromstring(svg(FIGURES["masks"](), "a", "words"))
    images = [e.get("href") for e in root.iter() if e.tag == "image"]
    assert sum(link.startswith("data:image/png;base64,") for link in images) >= 36


@pytest.mark.parametrize("name", ["heat", "contour"])
def test_ink_on_colour_maps_is_not_the_pages(name):
    """The page's ink turns light on a dark page, and the map beneath does not."""
    figure = FIGURES[name]()
    inks = {maps.ON_LIGHT, maps.ON_DARK}
    for ax in figure.axes:
        assert {text.get_color() for text in ax.texts} <= inks
        assert {line.get_color() for line in ax.lines} <= inks
    assert all(ink in svg(figure, "a", "words") for ink in inks)


# Noise axis


def test_both_noises_share_one_noise_axis():
    results = results_of()
    left, right = maps.error_figure(results).axes
    assert [ax.get_title(loc="left") for ax in (left, right)] == [
        "Gaussian read noise",
        "photon noise",
    ]
    assert left.get_xlim() == right.get_xlim()
    assert left.get_ylim() == right.get_ylim() == (0, 1)
    start, end = left.get_xlim()
    errors = [
        impulse_imaging_error(photons, 0.37, 1024, noise, 2.0)
        for noise in ("gaussian", "poisson")
        for photons in BUDGETS
    ]
    assert start > max(errors) > min(errors) > end
    assert "less noise →" in maps.error_figure(results).get_supxlabel()


@pytest.mark.parametrize(("noise", "panel"), [("gaussian", 0), ("poisson", 1)])
def test_points_stand_at_their_error(noise, panel):
    results = results_of(designs=("deepfsi",))
    ax = maps.error_figure(results).axes[panel]
    (line,) = (line for line in ax.lines if line.get_label() == "DFSI")
    errors = [impulse_imaging_error(photons, 0.37, 1024, noise, 2.0) for photons in BUDGETS]
    chosen = [p for p in results["points"] if p["noise"] == noise and p["best"]]
    np.testing.assert_allclose(line.get_xdata(), errors)
    np.testing.assert_allclose(line.get_ydata(), [p["accuracy"] for p in chosen])


def test_circles_are_feature_specific_on_the_noise_axis():
    ax = maps.error_figure(results_of()).axes[1]
    markers = {line.get_label(): line.get_marker() for line in ax.lines}
    circles = {name for name, marker in markers.items() if marker == "o"}
    assert circles == {"FSI", "DFSI", "CG"}
    assert {name for name, marker in markers.items() if marker == "s"} == {"II", "RS", "HB", "TH"}


def test_names_stand_at_the_end_with_least_noise():
    ax = maps.error_figure(results_of(designs=("deepfsi",))).axes[1]
    arrow = max((t for t in ax.texts if isinstance(t, Annotation)), key=lambda t: t.xy[1])
    assert arrow.xy[0] == pytest.approx(impulse_imaging_error(1e8, 0.37, 1024, "poisson"))


@pytest.mark.parametrize("case", [{"noises": ("gaussian",)}, {"budgets": [1e4]}, {"ratios": [0.5]}])
def test_noise_axis_of_small_comparisons(case):
    assert_legible(maps.error_figure(results_of(**case)))


def test_noise_axis_needs_a_noise_that_has_one():
    with pytest.raises(InputError, match="no impulse-imaging error for ml_gauss"):
        maps.error_figure(results_of(noises=("ml_gauss",)))


# Compression


def test_grid_holds_every_point_once_and_gaps_are_nan():
    points = [p for p in results_of(("poisson",), designs=("pca",))["points"] if p["ratio"] < 1]
    grid = maps.accuracy_grid(points, BUDGETS, RATIOS)
    assert np.isnan(grid[-1]).all()
    for point in points:
        place = RATIOS.index(point["ratio"]), BUDGETS.index(point["photons"])
        assert grid[place] == point["accuracy"]
    with pytest.raises(ValueError, match="two points"):
        maps.accuracy_grid([*points, points[0]], BUDGETS, RATIOS)


def test_heat_maps_share_one_scale_and_one_bar():
    figure = FIGURES["heat"]()
    *panels, bar = figure.axes
    meshes = [next(c for c in ax.collections if isinstance(c, QuadMesh)) for ax in panels]
    assert len(meshes) == 3
    assert len({mesh.norm for mesh in meshes}) == 1
    assert meshes[0].get_clim() == (0.0, 1.0)
    assert bar.get_ylabel() == "accuracy"
    assert bar.get_ylim() == (0.0, 1.0)
    for mesh, seed in zip(meshes, (1, 2, 3), strict=True):
        np.testing.assert_array_equal(mesh.get_array(), accuracies(seed))
    lightness = matplotlib.colormaps[maps.SEQUENTIAL](np.linspace(0, 1, 50))[:, :3] @ (
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


# Contours


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
    assert "−0.03" in [label.get_text() for label in bars[1].get_yticklabels()]
    none = dots_of(right)[0].cmap(dots_of(right)[0].norm(0.0))
    assert np.ptp(none[:3]) < 0.02
    assert [ax.get_title(loc="left") for ax in (left, middle, right)] == ["A", "B", "difference"]
    assert bars[1].get_ylabel() == "B\n− A"


@pytest.mark.parametrize("largest", [0, 1e-4, 0.012, 0.0225, 0.1, 0.47, 1])
def test_levels_of_differences_hold_all_and_never_magnify_noise(largest):
    levels = maps._difference_levels(np.array([[largest, np.nan], [-largest / 2, 0.0]]))
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
        figure = maps.contour_figure(grid, grid, BUDGETS, RATIOS, ("A", "B"), pixels=pixels)
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
    if gap:
        second[0, -1] = np.nan
    figure = maps.contour_figure(first, second, budgets, ratios, ("A", "B"), pixels=64)
    assert_legible(figure)
    left, middle, right = (sum(len(d.get_offsets()) for d in dots_of(ax)) for ax in figure.axes[:3])
    assert left == first.size
    assert middle == right == first.size - gap


# Masks


def test_six_masks_of_each_noise_and_budget_on_their_own_scale():
    rows = mask_rows()
    figure = maps.masks_table_figure(rows)
    images = [ax.images[0] for ax in figure.axes if ax.images]
    assert len(images) == 36
    for place, row in enumerate(rows):
        for half, noise in enumerate(("gaussian", "poisson")):
            shown = images[12 * place + 6 * half :][:6]
            end = np.abs(row[noise]).max()
            assert {image.get_clim() for image in shown} == {(-end, end)}
            light = [np.abs(image.get_array()).sum() for image in shown]
            assert light == sorted(light, reverse=True)
            assert f"peak {end:.2g}" in [text.get_text() for text in figure.texts]
            tile = shown[0].axes.get_window_extent()
            assert tile.height / tile.width == pytest.approx(6 / 4)
    grey = images[0].to_rgba(np.zeros((1, 1)))[0, 0, :3]
    np.testing.assert_allclose(grey, 0.5, atol=0.01)


def patch_rows(budgets=(1e2, 1e4, 1e6), masks=9, side=3):
    rng = np.random.default_rng(1)
    return [
        {"photons": photons, "side": side, "matrix": rng.normal(size=(masks, side**2)) / 20}
        for photons in budgets
    ]


@pytest.mark.parametrize("budgets", [(1e2,), (1e2, 1e4, 1e6)])
def test_all_masks_of_a_patch_brightest_first(budgets):
    rows = patch_rows(budgets)
    figure = maps.patch_masks_figure(rows)
    for ax, row in zip(figure.axes, rows, strict=True):
        (image,) = ax.images
        end = np.abs(row["matrix"]).max()
        assert image.get_clim() == (-end, end)
        assert f"peak {end:.2g}" == ax.get_xlabel()
        sheet = np.ma.filled(image.get_array(), np.nan)
        finer = len(sheet) // (3 * 4 - 1)
        sheet = sheet[::finer, ::finer]
        tiles = [sheet[i : i + 3, j : j + 3] for i in (0, 4, 8) for j in (0, 4, 8)]
        light = [np.abs(tile).sum() for tile in tiles]
        assert light == sorted(light, reverse=True)
        assert sorted(light) == pytest.approx(sorted(np.abs(row["matrix"]).sum(axis=1)))
        assert np.isnan(sheet[3]).all()


def test_masks_that_do_not_fill_their_square():
    figure = maps.patch_masks_figure(patch_rows(masks=7))
    assert len(figure.axes) == 3


def test_distributions_hold_every_value_of_both_noises():
    figure = maps.masks_table_figure(mask_rows())
    panels = [ax for ax in figure.axes if len(ax.patches) == 2]
    assert len(panels) == 3
    for ax in panels:
        assert ax.get_yscale() == "log"
        assert ax.get_xlim() == (-1, 1)
        assert ax.get_ylim() == panels[0].get_ylim()
        for outline in ax.patches:
            heights, edges, _ = outline.get_data()
            assert heights.sum() == pytest.approx(1)
            assert edges[0] == -edges[-1] == -1
            assert ax.get_ylim()[0] < heights[heights > 0].min()
    styles = {outline.get_linestyle() for outline in panels[0].patches}
    assert len(styles) == 2


def test_rails_few_masks_and_dark_ones():
    rows = mask_rows(budgets=(30.0,), counts=(2, 1))
    rows[0]["gaussian"] = np.stack(
        [rows[0]["gaussian"].clip(0), -rows[0]["gaussian"].clip(None, 0)]
    )
    rows[0]["poisson"] = rows[0]["poisson"] * 0
    figure = maps.masks_table_figure(rows)
    assert len([ax for ax in figure.axes if ax.images]) == 3
    assert_legible(figure)


# Measures and starts


def test_each_measure_has_a_panel_and_each_series_a_look():
    rows = measure_rows()
    figure = maps.measures_figure(rows)
    assert [ax.get_title(loc="left").replace("\n", " ") for ax in figure.axes] == [
        "light throughput",
        "effective number of directions",
        "subspace similarity",
    ]
    for ax in figure.axes:
        heading = ax.get_title(loc="left").replace("\n", " ")
        assert ax.get_ylim()[0] == 0
        drawn = [bars.lines[0].get_ydata().tolist() for bars in ax.containers]
        kept = [row for row in rows if row["measure"] == heading]
        names = list(dict.fromkeys(row["series"] for row in kept))
        assert drawn == [[r["value"] for r in kept if r["series"] == name] for name in names]
        for bars, name in zip(ax.containers, names, strict=True):
            ends = [segment[:, 1].tolist() for segment in bars.lines[2][0].get_segments()]
            np.testing.assert_allclose(
                ends, [[r["low"], r["high"]] for r in kept if r["series"] == name]
            )
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == ["Gaussian read noise", "photon noise", "AGN with PN", "random masks"]
    looks = {
        (line.get_linestyle(), line.get_marker())
        for line in (bars.lines[0] for ax in figure.axes for bars in ax.containers)
    }
    assert len(looks) >= 3


def test_measures_of_one_budget_without_intervals():
    rows = [{**row, "low": None, "high": None} for row in measure_rows([1e4])]
    assert_legible(maps.measures_figure(rows))
    assert_legible(maps.measures_figure([r for r in rows if r["measure"] == "light throughput"]))


def test_starts_are_drawn_beside_their_paired_differences():
    results = starts_of(("gaussian", "poisson"))
    figure = maps.starts_figure(results)
    assert len(figure.axes) == 4
    left, right = figure.axes[2:]
    assert len(left.containers) == 3
    assert [bars.lines[0].get_ydata()[0] for bars in right.containers] == [-0.01, -0.06]
    ends = right.containers[1].lines[2][0].get_segments()[0][:, 1]
    np.testing.assert_allclose(ends, [-0.064, -0.056])
    for panel in (left, right):
        colours = [bars.lines[0].get_color() for bars in panel.containers]
        assert colours[-2:] == [maps.COLOURS["truncated-hadamard"], maps.COLOURS["random"]]
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == ["pca", "truncated-hadamard", "random", "chance"]
    across = [bars.lines[0].get_xdata()[0] for bars in left.containers]
    assert len(set(across)) == 3
    np.testing.assert_allclose(across, 100, rtol=0.2)


@pytest.mark.parametrize("case", [{"budgets": [1e4]}, {"ends": False}, {"budgets": [30.0, 300.0]}])
def test_starts_of_one_budget_or_one_trial(case):
    assert_legible(maps.starts_figure(starts_of(**case)))
