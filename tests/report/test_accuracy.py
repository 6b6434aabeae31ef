"""Figures of accuracy say what the numbers say."""

import numpy as np

from deepfsi.report.accuracy import accuracy_figure
from shared.figures import assert_legible
from shared.results import DESIGNS, make_results, with_all


def test_feature_specific_designs_are_circles_and_others_squares(tmp_path):
    results = make_results(tmp_path)
    figure = accuracy_figure(results)
    (ax,) = figure.axes
    drawn = [line for line in ax.lines if not line.get_label().startswith("_")]
    markers = {line.get_label(): line.get_marker() for line in drawn}
    circles, squares = {"PCA (FSI)", "DeepFSI"}, {"impulse imaging", "raster scan"}
    squares |= {"truncated Hadamard"}
    assert markers == dict.fromkeys(circles, "o") | dict.fromkeys(squares, "s")
    assert ax.get_xscale() == "log"
    named = {text.get_text() for text in ax.texts}
    assert named == {"", "chance", *markers}
    assert len({line.get_color() for line in drawn}) == len(DESIGNS)


def test_error_bars_are_the_intervals(tmp_path):
    results = make_results(tmp_path, designs=("deepfsi",))
    best = [p for p in results.points if p.best]
    (ax,) = accuracy_figure(results).axes
    (bar,) = (c for c in ax.collections if "LineCollection" in type(c).__name__)
    ends = [sorted(segment[:, 1]) for segment in bar.get_segments()]
    np.testing.assert_allclose(ends, [[p.low, p.high] for p in best])


def test_one_budget_is_a_ranking_without_an_empty_half(tmp_path):
    results = make_results(tmp_path, budgets=(1e3,), noises=("poisson", "gaussian"))
    figure = accuracy_figure(results)
    assert_legible(figure)
    heads = [ax.get_title(loc="left") for ax in figure.axes]
    assert heads == ["photon noise", "Gaussian read noise"]
    for ax, noise in zip(figure.axes, ("poisson", "gaussian"), strict=True):
        best = [p for p in results.points if p.best and p.noise == noise]
        ordered = sorted(best, key=lambda p: p.accuracy)
        assert [label.get_text() for label in ax.get_yticklabels()] == [p.title for p in ordered]
        bars = [c for c in ax.collections if "LineCollection" in type(c).__name__]
        ends = [bar.get_segments()[0][:, 0] for bar in bars]
        np.testing.assert_allclose(ends, [[p.low, p.high] for p in ordered])
        across = [line.get_xdata()[0] for line in ax.lines if line.get_marker() in ("o", "s")]
        np.testing.assert_allclose(across, [p.accuracy for p in ordered])


def test_names_at_the_edge_do_not_touch(tmp_path):
    results = make_results(tmp_path, designs=("pca", "deepfsi", "truncated-hadamard"))
    figure = accuracy_figure(with_all(results, accuracy=0.99, low=0.99, high=0.99))
    figure.draw_without_rendering()
    boxes = [t.get_window_extent() for t in figure.axes[0].texts if t.get_text()]
    assert len(boxes) == 4
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
