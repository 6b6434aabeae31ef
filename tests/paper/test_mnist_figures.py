"""Figures of the study on MNIST: what they show is what they were given, and words can be read."""

import itertools
import math
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.text import Annotation

from deepfsi.base import InputError
from deepfsi.jobs import DESIGNS as CODES
from deepfsi.jobs import mask_count
from deepfsi.report.style import DESIGN_COLOURS
from deepfsi.report.style.figures import svg
from deepfsi_paper.measures import impulse_imaging_error
from deepfsi_paper.mnist import figures
from deepfsi_paper.mnist.figures import LearnedMasks, Measure, Start
from shared.figures import assert_legible, assert_sound
from shared.results import a_point, some_results

BUDGETS = [1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8]

RATIOS = [mask_count((k / 10) ** 2, 1024) / 1024 for k in range(1, 11)]

DESIGNS = ("impulse", "raster", "hadamard", "truncated-hadamard", "pca", "deepfsi", "control")


def results_of(noises=("poisson", "gaussian"), budgets=BUDGETS, designs=DESIGNS, ratios=RATIOS):
    points = []
    for noise, (place, design), photons in itertools.product(noises, enumerate(designs), budgets):
        code = CODES[design]
        own = [1.0] if code.complete else ratios
        for ratio in own:
            middle = 3 + 0.3 * place + (noise == "gaussian")
            accuracy = 0.1 + 0.87 / (1 + math.exp(2 * (middle - math.log10(photons)))) - ratio / 50
            points.append(
                a_point(
                    accuracy,
                    design=design,
                    label=code.label,
                    title=code.title,
                    specific=code.specific,
                    noise=noise,
                    photons=photons,
                    masks=round(1024 * ratio),
                    ratio=ratio,
                    low=accuracy - 0.01,
                    high=accuracy + 0.02,
                    best=ratio == own[0],
                )
            )
    return some_results(
        points, recipe={"camera": {"sigma": [2.0]}}, data={"mean_reflectance": 0.37}
    )


def mask_rows(budgets=(1e3, 1e5, 1e8), shape=(6, 4), counts=(9, 7)):
    rng = np.random.default_rng(0)
    return [
        LearnedMasks(
            photons,
            shape,
            gaussian=rng.normal(size=(counts[0], math.prod(shape))) / 7,
            poisson=rng.normal(size=(counts[1], math.prod(shape))) ** 3 / 50,
        )
        for photons in budgets
    ]


PANELS = {
    "light throughput": ("light throughput", "share of the budget"),
    "effective number of directions": ("effective number of directions", "effective rank"),
    "subspace similarity": ("subspace similarity", "overlap, 0 to 1"),
}
NAMES = {"AGN with PN": "both noises"}


def measure_rows(budgets=BUDGETS):
    values = {
        ("light throughput", "gaussian"): 0.9,
        ("effective number of directions", "gaussian"): 30 * 0.9,
        ("light throughput", "poisson"): 0.4,
        ("effective number of directions", "poisson"): 30 * 0.4,
        ("subspace similarity", "AGN with PN"): 0.6,
        ("subspace similarity", "random masks"): 0.04,
    }
    return [
        Measure(measure, series, photons, value, 0.9 * value, 1.1 * value)
        for photons in budgets
        for (measure, series), value in values.items()
    ]


def starts_of(noises=("poisson",), budgets=BUDGETS, ends=True):
    starts = {"pca": 0.0, "truncated-hadamard": -0.01, "random": -0.06}
    accuracies, differences = [], []
    for noise, photons, (start, loss) in itertools.product(noises, budgets, starts.items()):
        value = 0.2 + 0.09 * math.log10(photons) + loss
        accuracies.append(Start(noise, start, photons, value, value - 0.01, value + 0.01))
        if loss:
            low, high = (loss - 0.004, loss + 0.004) if ends else (None, None)
            differences.append(Start(noise, start, photons, loss, low, high))
    return accuracies, differences, 0.1


FIGURES = {
    "error": lambda: figures.error_figure(results_of()),
    "masks": lambda: figures.masks_table_figure(mask_rows()),
    "measures": lambda: figures.measures_figure(measure_rows(), PANELS, NAMES),
    "starts": lambda: figures.starts_figure(*starts_of()),
    "both starts": lambda: figures.starts_figure(*starts_of(("gaussian", "poisson"))),
}

every_figure = pytest.mark.parametrize("draw", FIGURES.values(), ids=FIGURES.keys())


@every_figure
def test_words_can_be_read(draw):
    figure = draw()
    assert figure.get_figwidth() <= 10
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
    assert_sound(draw)


def test_mask_images_are_inside_the_fragment():
    root = ElementTree.fromstring(svg(FIGURES["masks"](), "a", "words"))
    images = [e.get("href") for e in root.iter() if e.tag == "image"]
    assert sum(link.startswith("data:image/png;base64,") for link in images) >= 36


def test_both_noises_share_one_noise_axis():
    results = results_of()
    left, right = figures.error_figure(results).axes
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
    assert all("less noise →" in ax.get_xlabel() for ax in (left, right))


@pytest.mark.parametrize(("noise", "panel"), [("gaussian", 0), ("poisson", 1)])
def test_points_stand_at_their_error(noise, panel):
    results = results_of(designs=("deepfsi",))
    ax = figures.error_figure(results).axes[panel]
    (line,) = (line for line in ax.lines if line.get_label() == "DeepFSI")
    errors = [impulse_imaging_error(photons, 0.37, 1024, noise, 2.0) for photons in BUDGETS]
    chosen = [p for p in results.points if p.noise == noise and p.best]
    np.testing.assert_allclose(line.get_xdata(), errors)
    np.testing.assert_allclose(line.get_ydata(), [p.accuracy for p in chosen])


def test_circles_are_feature_specific_on_the_noise_axis():
    ax = figures.error_figure(results_of()).axes[1]
    markers = {line.get_label(): line.get_marker() for line in ax.lines}
    circles = {name for name, marker in markers.items() if marker == "o"}
    assert circles == {"PCA", "DeepFSI", "control group"}
    squares = {name for name, marker in markers.items() if marker == "s"}
    assert squares == {"impulse imaging", "raster scan", "Hadamard basis", "truncated Hadamard"}


def test_names_stand_at_the_end_with_least_noise():
    ax = figures.error_figure(results_of(designs=("deepfsi",))).axes[1]
    arrow = max((t for t in ax.texts if isinstance(t, Annotation)), key=lambda t: t.xy[1])
    assert arrow.xy[0] == pytest.approx(impulse_imaging_error(1e8, 0.37, 1024, "poisson"))


@pytest.mark.parametrize("case", [{"noises": ("gaussian",)}, {"budgets": [1e4]}, {"ratios": [0.5]}])
def test_noise_axis_of_small_comparisons(case):
    assert_legible(figures.error_figure(results_of(**case)))


def test_noise_axis_needs_a_noise_that_has_one():
    with pytest.raises(InputError, match="no impulse-imaging error for ml_gauss"):
        figures.error_figure(results_of(noises=("ml_gauss",)))


def test_six_masks_of_each_noise_and_budget_on_their_own_scale():
    rows = mask_rows()
    figure = figures.masks_table_figure(rows)
    images = [ax.images[0] for ax in figure.axes if ax.images]
    assert len(images) == 36
    for place, row in enumerate(rows):
        for half, noise in enumerate(("gaussian", "poisson")):
            shown = images[12 * place + 6 * half :][:6]
            end = np.abs(row.under(noise)).max()
            assert {image.get_clim() for image in shown} == {(-end, end)}
            light = [np.abs(image.get_array()).sum() for image in shown]
            assert light == sorted(light, reverse=True)
            assert f"peak {end:.2g}" in [text.get_text() for text in figure.texts]
            tile = shown[0].axes.get_window_extent()
            assert tile.height / tile.width == pytest.approx(6 / 4)
    grey = images[0].to_rgba(np.zeros((1, 1)))[0, 0, :3]
    np.testing.assert_allclose(grey, 0.5, atol=0.01)


def test_distributions_hold_every_value_of_both_noises():
    figure = figures.masks_table_figure(mask_rows())
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
    matrix, dark = rows[0].gaussian, rows[0].poisson * 0
    rails = np.stack([matrix.clip(0), -matrix.clip(None, 0)])
    figure = figures.masks_table_figure([replace(rows[0], gaussian=rails, poisson=dark)])
    assert len([ax for ax in figure.axes if ax.images]) == 3
    assert_legible(figure)


def test_each_measure_has_a_panel_and_each_series_a_look():
    rows = measure_rows()
    figure = figures.measures_figure(rows, PANELS, NAMES)
    assert [ax.get_ylabel() for ax in figure.axes] == [label for _, label in PANELS.values()]
    assert {ax.get_xlabel() for ax in figure.axes} == {"photon budget Φ (photons)"}
    assert [ax.get_title(loc="left").replace("\n", " ") for ax in figure.axes] == [
        "light throughput",
        "effective number of directions",
        "subspace similarity",
    ]
    for ax in figure.axes:
        heading = ax.get_title(loc="left").replace("\n", " ")
        assert ax.get_ylim()[0] == 0
        drawn = [bars.lines[0].get_ydata().tolist() for bars in ax.containers]
        kept = [row for row in rows if row.measure == heading]
        names = list(dict.fromkeys(row.series for row in kept))
        assert drawn == [[r.value for r in kept if r.series == name] for name in names]
        for bars, name in zip(ax.containers, names, strict=True):
            ends = [segment[:, 1].tolist() for segment in bars.lines[2][0].get_segments()]
            np.testing.assert_allclose(ends, [[r.low, r.high] for r in kept if r.series == name])
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    named = ["Gaussian read noise", "photon noise", "both noises", "random masks"]
    assert legend == [*named, "95 % interval"]
    looks = {
        (line.get_linestyle(), line.get_marker())
        for line in (bars.lines[0] for ax in figure.axes for bars in ax.containers)
    }
    assert len(looks) >= 3


def test_measures_of_one_budget_without_intervals():
    rows = [replace(row, low=None, high=None) for row in measure_rows([1e4])]
    assert_legible(figures.measures_figure(rows, PANELS))
    one = [row for row in rows if row.measure == "light throughput"]
    assert_legible(figures.measures_figure(one, PANELS))


def test_starts_are_drawn_beside_their_paired_differences():
    results = starts_of(("gaussian", "poisson"))
    figure = figures.starts_figure(*results)
    assert len(figure.axes) == 4
    left, right = figure.axes[2:]
    assert len(left.containers) == 3
    assert [bars.lines[0].get_ydata()[0] for bars in right.containers] == [-0.01, -0.06]
    ends = right.containers[1].lines[2][0].get_segments()[0][:, 1]
    np.testing.assert_allclose(ends, [-0.064, -0.056])
    for panel in (left, right):
        colours = [bars.lines[0].get_color() for bars in panel.containers]
        assert colours[-2:] == [DESIGN_COLOURS["truncated-hadamard"], DESIGN_COLOURS["random"]]
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == ["from PCA", "from truncated Hadamard", "from random ±1", "chance"]
    across = [bars.lines[0].get_xdata()[0] for bars in left.containers]
    assert len(set(across)) == 3
    np.testing.assert_allclose(across, 100, rtol=0.2)


@pytest.mark.parametrize("case", [{"budgets": [1e4]}, {"ends": False}, {"budgets": [30.0, 300.0]}])
def test_starts_of_one_budget_or_one_trial(case):
    assert_legible(figures.starts_figure(*starts_of(**case)))
