"""Figures of the study on MNIST: what they show is what they were given, and words can be read."""

import itertools
import math

import numpy as np
import pytest

from deepfsi.jobs import DESIGNS as CODES
from deepfsi.jobs import mask_count
from deepfsi.report.style import DESIGN_COLOURS
from deepfsi_paper import measures
from deepfsi_paper.mnist import figures
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
        figures.LearnedMasks(
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
        figures.Measure(measure, series, photons, value, 0.9 * value, 1.1 * value)
        for photons in budgets
        for (measure, series), value in values.items()
    ]


def starts_of(noises=("poisson",), budgets=BUDGETS, ends=True):
    starts = {"pca": 0.0, "truncated-hadamard": -0.01, "random": -0.06}
    accuracies, differences = [], []
    for noise, photons, (start, loss) in itertools.product(noises, budgets, starts.items()):
        value = 0.2 + 0.09 * math.log10(photons) + loss
        accuracies.append(figures.Start(noise, start, photons, value, value - 0.01, value + 0.01))
        if loss:
            low, high = (loss - 0.004, loss + 0.004) if ends else (None, None)
            differences.append(figures.Start(noise, start, photons, loss, low, high))
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


@every_figure
def test_fragments_are_sound_and_settings_untouched(draw):
    assert_sound(draw)


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
        measures.impulse_imaging_error(photons, 0.37, 1024, noise, 2.0)
        for noise in ("gaussian", "poisson")
        for photons in BUDGETS
    ]
    assert start > max(errors) > min(errors) > end
    assert all("less noise →" in ax.get_xlabel() for ax in (left, right))


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
