"""What all figures share: settings, colours of the page, and words."""

import matplotlib.style
from cycler import cycler

from deepfsi.report.accuracy import accuracy_figure
from deepfsi.report.style import Figures, photons_text
from shared.results import make_results

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
