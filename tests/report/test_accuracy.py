"""Figures of accuracy say what the numbers say."""

import numpy as np

from deepfsi.report.accuracy import accuracy_figure
from shared.figures import assert_legible
from shared.results import DESIGNS, make_results


def test_feature_specific_designs_are_circles_and_others_squares(tmp_path):
    results = make_results(tmp_path)
    figure = accuracy_figure(results)
    assert_legible(figure)
    (ax,) = figure.axes
    lines = {each.get_label(): each.lines[0] for each in ax.containers}
    markers = {name: line.get_marker() for name, line in lines.items()}
    circles, squares = {"PCA (FSI)", "DeepFSI"}, {"impulse imaging", "raster scan"}
    squares |= {"truncated Hadamard"}
    assert markers == dict.fromkeys(circles, "o") | dict.fromkeys(squares, "s")
    assert ax.get_xscale() == "log"
    named = [text.get_text() for text in ax.get_legend().get_texts()]
    last = {p.title: p.accuracy for p in results.points if p.best}  # at the brightest budget
    assert named == [*sorted(markers, key=last.get, reverse=True), "chance"]
    assert len({line.get_color() for line in lines.values()}) == len(DESIGNS)


def test_error_bars_are_the_intervals(tmp_path):
    results = make_results(tmp_path, designs=("deepfsi",))
    best = [p for p in results.points if p.best]
    (ax,) = accuracy_figure(results).axes
    (bar,) = (c for c in ax.collections if "LineCollection" in type(c).__name__)
    ends = [sorted(segment[:, 1]) for segment in bar.get_segments()]
    np.testing.assert_allclose(ends, [[p.low, p.high] for p in best])
