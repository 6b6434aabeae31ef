"""The report: one page that needs nothing else, and figures that say what the numbers say."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from deepfsi.errors import InputError
from deepfsi.report import accuracy_figure, build, count_figure, masks_figure, values_figure
from deepfsi.report.comparison_page import summary
from deepfsi.report.masks import signed
from deepfsi.report.style import photons_text, svg
from deepfsi.sweeps.results import write_results
from shared.results import DESIGNS, make_results, with_all


def page_of(folder):
    return build(folder).read_text(encoding="utf-8")


def words_of(page):
    """Text that a reader sees, without styles and scripts."""
    bare = re.sub(r"<(style|script).*?</\1>", "", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", bare))


class Wellformed(HTMLParser):
    """Collects ids and addresses, and checks that elements close in order."""

    VOID = frozenset(("meta", "path", "use", "image", "circle", "rect", "br"))

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.addresses = [], [], []

    def handle_starttag(self, tag, attrs):
        self.ids += [value for name, value in attrs if name == "id"]
        self.addresses += [v for name, v in attrs if name in ("src", "href", "xlink:href")]
        self.addresses += re.findall(r"url\(([^)]*)\)", " ".join(v or "" for _, v in attrs))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag


def test_page_is_one_self_contained_document(tmp_path):
    make_results(tmp_path, noises=("poisson", "gaussian"))
    page = page_of(tmp_path)
    parser = Wellformed()
    parser.feed(page)
    assert parser.open == []
    assert len(parser.ids) == len(set(parser.ids)) > 100
    for address in parser.addresses:
        assert address.startswith(("data:image/png;base64,", "#"))
        assert address[0] != "#" or address[1:] in parser.ids
    assert not re.search(r"https?:|//fonts|@import", page)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "accuracy.png",
        "designs",
        "report.html",
        "results.json",
    ]


def test_all_designs_and_numbers_are_in_the_tables(tmp_path):
    results = make_results(tmp_path)
    text = words_of(page_of(tmp_path))
    for point in results.points:
        assert f"{point.accuracy:.3f}" in text
        assert f"{point.low:.3f}" in text
        assert f"{point.high:.3f}" in text
        assert point.label in text
        assert point.title in text
    assert "100 photons" in text
    assert "10⁴ photons" in text
    for told in (
        "was chosen on validation data",
        "seeds of training (t over 3 trials)",
        "deepfsi compare --data digits -o out",
        "abc123",
        "training.epochs 20",
        "training.hidden 40, 128",
        "seconds 63.1",
    ):
        assert told in text


def test_sections_come_in_order(tmp_path):
    make_results(tmp_path)
    titles = re.findall(r"<h2>(.*?)</h2>", page_of(tmp_path))
    assert titles == [
        "Accuracy and photons",
        "Best number of masks at each budget",
        "Accuracy and number of masks",
        "Learned masks and the distribution of their values",
        "All results",
        "How to repeat it",
        "Provenance",
    ]


def test_summary_follows_the_numbers(tmp_path):
    results = make_results(tmp_path)
    text = summary(results, "poisson")
    assert (
        "DeepFSI is the most accurate design with one detector at 100 and 10⁴ photons; chance"
        in text
    )
    assert "At 100 photons DeepFSI with 4 masks reaches 0.706 (0.702–0.710)" in text
    assert "followed by PCA (FSI) with 0.616" in text
    assert "do not overlap" in text
    assert "Impulse imaging, with a detector for each pixel, reaches 0.796" in text
    assert "do not overlap" not in summary(with_all(results, low=0.0, high=1.0), "poisson")


def test_feature_specific_designs_are_circles_and_others_squares(tmp_path):
    results = make_results(tmp_path)
    figure = accuracy_figure(results)
    (ax,) = figure.axes
    drawn = [line for line in ax.lines if not line.get_label().startswith("_")]
    markers = {line.get_label(): line.get_marker() for line in drawn}
    assert markers == {"FSI": "o", "DFSI": "o", "II": "s", "RS": "s", "TH": "s"}
    assert ax.get_xscale() == "log"
    named = {text.get_text() for text in ax.texts}
    assert named == {"", "chance", *markers}
    assert len({line.get_color() for line in drawn}) == len(DESIGNS)


def test_error_bars_are_the_intervals(tmp_path):
    results = make_results(tmp_path, designs=("deepfsi",), budgets=(1e3,))
    best = next(p for p in results.points if p.best)
    (ax,) = accuracy_figure(results).axes
    (bar,) = (c for c in ax.collections if "LineCollection" in type(c).__name__)
    (segment,) = bar.get_segments()
    np.testing.assert_allclose(sorted(segment[:, 1]), [best.low, best.high])


def test_names_at_the_edge_do_not_touch(tmp_path):
    results = make_results(tmp_path, designs=("pca", "deepfsi", "truncated-hadamard"))
    figure = accuracy_figure(with_all(results, accuracy=0.99, low=0.99, high=0.99))
    figure.draw_without_rendering()
    boxes = [t.get_window_extent() for t in figure.axes[0].texts if t.get_text()]
    assert len(boxes) == 4
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_each_noise_has_a_panel_and_each_light_a_series(tmp_path):
    results = make_results(
        tmp_path,
        designs=("impulse", "deepfsi"),
        noises=("poisson", "gaussian"),
        lights=("column", "free-dwell"),
    )
    results = results.with_points(
        p for p in results.points if (p.design, p.light) != ("impulse", "free-dwell")
    )
    write_results(tmp_path / "results.json", results)
    panels = accuracy_figure(results).axes
    assert [ax.get_title(loc="left") for ax in panels] == ["photon noise", "Gaussian read noise"]
    names = {text.get_text() for text in panels[0].texts} - {"", "chance"}
    assert names == {"II", "DFSI column", "DFSI free-dwell"}
    assert len(count_figure(results).axes) == 4
    text = words_of(page_of(tmp_path))
    assert "DeepFSI free-dwell, Gaussian read noise" in text


def test_masks_have_a_symmetric_scale_and_one_colour_bar():
    matrix = np.random.default_rng(1).normal(0.3, 1, (14, 24))
    figure = masks_figure(matrix, (4, 6), title="a $title$ as it is")
    images = [ax.images[0] for ax in figure.axes if ax.images and ax.get_visible()]
    assert len(images) == 12
    limits = {image.get_clim() for image in images}
    assert limits == {(-np.abs(matrix).max(), np.abs(matrix).max())}
    middle = images[0].to_rgba(np.zeros((1, 1)))[0, 0, :3]
    assert np.ptp(middle) < 0.02
    labels = [ax.get_xlabel() for ax in figure.axes if ax.get_xlabel()]
    assert labels == ["share of a pixel's photons, Mᵢⱼ"]
    energy = [np.abs(image.get_array()).sum() for image in images]
    assert energy == sorted(energy, reverse=True)
    assert figure.get_suptitle() == "a $title$ as it is"


def test_rails_become_signed_masks():
    matrix = np.random.default_rng(2).normal(size=(3, 8))
    rails = np.stack([matrix.clip(min=0), -matrix.clip(max=0)])
    np.testing.assert_array_equal(signed(rails), matrix)
    np.testing.assert_array_equal(signed(rails[:1]), rails[0])
    np.testing.assert_array_equal(signed(matrix), matrix)


def test_spectra_are_curves():
    matrix = np.random.default_rng(3).normal(size=(4, 30))
    figure = masks_figure(matrix, (30,))
    curves = [ax.lines[-1].get_ydata() for ax in figure.axes if ax.get_visible()]
    assert len(curves) == 4
    assert all(any(np.array_equal(curve, row) for row in matrix) for curve in curves)
    assert not any(ax.images for ax in figure.axes)
    low, high = figure.axes[0].get_ylim()
    assert low == -high


def test_values_hold_every_entry_once():
    matrix = np.random.default_rng(4).normal(size=(5, 20))
    (ax,) = values_figure(matrix).axes
    heights, edges, _ = ax.patches[0].get_data()
    assert heights.sum() == pytest.approx(1)
    assert edges[0] == -edges[-1] == pytest.approx(-np.abs(matrix).max())
    assert ax.get_yscale() == "log"


@pytest.mark.parametrize(
    "case",
    [
        {"shape": (24,)},
        {"budgets": (1e3,)},
        {"designs": ("deepfsi",)},
        {"designs": ("impulse",)},
        {"designs": ("raster", "pca")},
        {"counts": (4,)},
        {"counts": (1, 2)},
        {"budgets": (30.0, 3e5), "noises": ("gaussian",)},
    ],
    ids=str,
)
def test_small_and_odd_comparisons_make_a_page(tmp_path, case):
    results = make_results(tmp_path, **case)
    page = page_of(tmp_path)
    assert ("<h2>Learned masks" in page) == any(p.learned for p in results.points)
    several = len({p.masks for p in results.points if p.design in ("pca", "deepfsi")}) > 1
    assert ("<h2>Accuracy and number of masks" in page) == several
    assert ("nothing was chosen" in page) == (results.chosen_on == "nothing")
    images = len(results.data.image_shape) == 2
    assert ("scale-figure_1" in page) == ("<h2>Learned masks" in page and images)


def test_dark_masks_can_be_drawn():
    dark = np.zeros((1, 4))
    assert svg(masks_figure(dark, (2, 2)), "a", "masks")
    assert svg(values_figure(dark), "b", "values")


def test_designs_that_were_not_kept_are_said_to_be_missing(tmp_path):
    make_results(tmp_path)
    for file in (tmp_path / "designs").iterdir():
        file.unlink()
    assert "design files of this comparison are not in its folder" in page_of(tmp_path)


def test_markup_in_names_is_text(tmp_path):
    bad = "<script>alert('x')</script>"
    results = make_results(tmp_path, title=bad, command=f"deepfsi compare --data '{bad}'")
    results = with_all(results, label=bad, title=bad, covers=bad, noise=f'"{bad}')
    changes = {"data": results.data.model_copy(update={"name": bad}), "recipe": {bad: bad}}
    write_results(tmp_path / "results.json", results.model_copy(update=changes))
    page = page_of(tmp_path)
    assert bad not in page
    assert "&lt;script&gt;" in page
    assert page.count("<script>") == 1


def test_same_results_make_the_same_page(tmp_path):
    make_results(tmp_path)
    assert page_of(tmp_path) == page_of(tmp_path)


def test_figures_leave_matplotlib_as_it_was(tmp_path):
    before = dict(matplotlib.rcParams)
    svg(accuracy_figure(make_results(tmp_path)), "a", "words")
    assert dict(matplotlib.rcParams) == before


def test_svg_colours_follow_the_page(tmp_path):
    text = svg(accuracy_figure(make_results(tmp_path)), "a", 'quoted "words"')
    assert "var(--deepfsi)" in text
    assert "var(--ink)" in text
    assert "#d55e00" not in text
    assert 'aria-label="quoted &quot;words&quot;"' in text
    assert "<metadata" not in text


@pytest.mark.parametrize(
    ("photons", "text"),
    [
        (30.0, "30"),
        (1e3, "1000"),
        (1e4, "10⁴"),
        (3e5, "3 × 10⁵"),
        (2.5e10, "2.5 × 10¹⁰"),
        (0.5, "0.5"),
    ],
)
def test_budgets_are_written_as_people_do(photons, text):
    assert photons_text(photons) == text


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (None, "no results in"),
        ("{", r"cannot be used: .*; run the comparison again"),
        ("[]", r"cannot be used: .*; run the comparison again"),
        ({"schema": 2, "points": []}, "upgrade deepfsi"),
        ({"points": []}, "no finished point"),
        ({"points": [{}]}, r"at points\.0\.trained_under"),
    ],
)
def test_folders_without_usable_results_are_refused(tmp_path, content, told):
    file = tmp_path / "results.json"
    if isinstance(content, dict):
        make_results(tmp_path)
        content = json.dumps({**json.loads(file.read_text()), **content})
    if content is not None:
        file.write_text(content)
    with pytest.raises(InputError, match=told):
        build(tmp_path)
    assert not (tmp_path / "report.html").exists()


def test_damaged_design_file_is_named(tmp_path):
    make_results(tmp_path)
    for file in (tmp_path / "designs").iterdir():
        file.write_bytes(b"no design")
    with pytest.raises(InputError, match=r"poisson-column-deepfsi-100-4\.safetensors"):
        build(tmp_path)


def test_report_needs_no_torch(tmp_path):
    make_results(tmp_path)
    code = (
        "import sys; from deepfsi.report import build; build(sys.argv[1]); "
        "assert not {'torch', 'matplotlib.pyplot'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True, cwd=Path.cwd())
