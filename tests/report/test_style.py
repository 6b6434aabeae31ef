"""Figures say what the numbers say, in settings, colours and words that all share."""

import matplotlib.style
import numpy as np
from cycler import cycler

from deepfsi.report.accuracy import accuracy_figure
from deepfsi.report.style import Figures, photons_text
from shared.figures import assert_legible
from shared.results import DESIGNS, make_results

CALLERS = [
    {
        "text.usetex": True,  # there may be no LaTeX
        **{"font.family": "no such font", "font.size": 40.0, "axes.unicode_minus": False},
        **{"savefig.bbox": "tight", "savefig.facecolor": "pink", "savefig.transparent": True},
        **{"figure.dpi": 30.0, "figure.autolayout": True, "path.simplify": False},
        **{"svg.fonttype": "none", "svg.hashsalt": "another", "pdf.fonttype": 42},
        **{"axes.prop_cycle": cycler(color=["red"]), "axes.grid": True, "image.cmap": "jet"},
    },
    dict(matplotlib.style.library["dark_background"]),
]
"""What a program may have set before a figure is drawn."""


def test_figures_are_the_same_whatever_the_caller_set(tmp_path):
    """On the page and as files; also a theme, and a font or a LaTeX that are not there."""
    results = make_results(tmp_path, designs=("raster", "deepfsi"), counts=(4,))

    def drawn(name):
        figures = Figures()
        page = figures.add("a", accuracy_figure(results), "words")
        figures.write(tmp_path / name)
        return page, [path.read_bytes() for path in sorted((tmp_path / name).rglob("a.*"))]

    wanted = drawn("plain")
    matplotlib.get_backend()  # chosen when it is first asked for, as by the comparison below
    for number, settings in enumerate(CALLERS):
        with matplotlib.rc_context(settings):
            before = matplotlib.rcParams.copy()
            assert drawn(str(number)) == wanted, settings
            assert matplotlib.rcParams == before


def test_budgets_are_written_as_people_do():
    budgets = {
        30.0: "30",
        1e3: "1000",
        1e4: "10⁴",
        3e5: "3 × 10⁵",
        2.5e10: "2.5 × 10¹⁰",
        0.5: "0.5",
    }
    assert {photons: photons_text(photons) for photons in budgets} == budgets


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
