"""The page of a comparison needs nothing else, and says what the numbers say."""

import json
import re

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.report.accuracy import accuracy_figure
from deepfsi.report.comparison_page import verdict_of, write_report
from deepfsi.report.style import photons_text
from deepfsi.sweeps.results import write_results
from shared.pages import assert_headed, assert_whole, run_without_torch, words_of
from shared.results import make_results, with_all

FILES = {"svg": b"<?xml", "pdf": b"%PDF-", "png": b"\x89PNG"}
"""How a file of each format begins."""

words_alone = pytest.mark.usefixtures("undrawn")
"""Tests of words beside figures, which then count none of a figure's."""


def page_of(folder, results=None):
    """The page of a folder, in which other results are written first."""
    if results is not None:
        write_results(folder / "results.json", results)
    return write_report(folder).read_text(encoding="utf-8")


def test_page_is_one_document_with_its_figures_beside_it(tmp_path):
    few = {"designs": ("raster", "deepfsi"), "budgets": (1e4,)}
    make_results(tmp_path, noises=("poisson", "gaussian"), **few)
    page = page_of(tmp_path)
    assert_whole(page, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"designs", "figures", "report.html", "results.json"}
    files = [*(tmp_path / "figures").iterdir()]
    assert len(files) == 3 * page.count('class="drawing"') > 6
    for file in files:
        assert file.read_bytes().startswith(FILES[file.suffix[1:]])


@words_alone
def test_all_designs_and_their_numbers_are_in_the_table(tmp_path):
    results = make_results(tmp_path)
    text = words_of(page_of(tmp_path))
    for point in (point for point in results.points if point.best):
        numbers = (point.accuracy, point.low, point.high)
        assert {point.title, *(f"{number:.3f}" for number in numbers)} <= set(
            re.findall(rf"\d\.\d{{3}}|{re.escape(point.title)}", text)
        )
    facts = ("100 photons", "10⁴ photons", "was chosen on validation data")
    assert all(told in text for told in (*facts, "deepfsi compare --data digits -o out"))


@words_alone
@pytest.mark.usefixtures("drawn_once")
@pytest.mark.parametrize(
    "case",
    [
        {"shape": (24,)},
        {"designs": ("deepfsi",)},
        {"designs": ("impulse",)},
        {"counts": (4,)},
        {"counts": (1, 2)},
        {"budgets": (30.0, 3e5), "noises": ("gaussian",)},
    ],
    ids=str,
)
def test_small_and_odd_comparisons_make_a_page(tmp_path, case):
    results = make_results(tmp_path, **case)
    page = page_of(tmp_path)
    assert_headed(page)
    several = len({p.masks for p in results.points if p.design in ("pca", "deepfsi")}) > 1
    assert ("<h2>Accuracy and number of masks" in page) == several
    assert ("nothing was chosen" in page) == (results.chosen_on == "nothing")
    assert ("<h2>Learned masks" in page) == any(p.learned for p in results.points)


def test_same_results_make_the_same_page_and_figures(tmp_path):
    """Also in another process, which needs no torch for them."""

    def files():
        return [path.read_bytes() for path in [page, *sorted(tmp_path.glob("figures/*"))]]

    make_results(tmp_path, designs=("raster", "deepfsi"), budgets=(1e3,), counts=(4,))
    page = write_report(tmp_path)
    first = files()
    page.unlink()
    run_without_torch(
        "from deepfsi.report.comparison_page import write_report; write_report(sys.argv[1])",
        tmp_path,
    )
    assert files() == first
    assert len(first) > 1


@words_alone
@pytest.mark.parametrize(
    ("content", "told"),
    [
        (None, "no results in"),
        ("{", "run the comparison again"),
        ("[]", "run the comparison again"),
        ({"schema": 6, "points": []}, "at schema: give 5; run"),
        ({"schema": 1, "points": []}, "at schema: give 5"),
        ({"points": []}, "at points: give 1 or more of them"),
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
        write_report(tmp_path)
    assert not (tmp_path / "report.html").exists()


@words_alone
def test_equal_designs_are_all_named_and_bold_and_those_of_one_class_are_marked(tmp_path):
    results = make_results(tmp_path, designs=("pca", "deepfsi", "truncated-hadamard"))
    data = results.data.model_copy(update={"chance": 0.891})
    equal = with_all(results, accuracy=0.891, low=0.8, high=0.95, one_class=True)
    equal = equal.model_copy(update={"data": data})
    page = page_of(tmp_path, equal)
    assert page.count('class="first"') == page.count("answers one class only</small>") == 6
    assert "0.891, the share of the commonest class" in words_of(page)
    heights = {line.get_ydata()[0] for line in accuracy_figure(equal).axes[0].lines}
    assert 0.891 in heights
    assert 0.1 not in heights


@words_alone
def test_the_confusion_matrix_is_that_of_the_best_design(tmp_path):
    results = make_results(tmp_path, designs=("raster", "pca"))
    assert "taken for which" not in page_of(tmp_path), "results of before have none"
    counts = np.eye(len(results.data.classes), dtype=int)
    counts[0, :2] = 7, 1
    best = verdict_of(results).best
    points = [
        point.model_copy(update={"confusion": tuple(map(tuple, counts.tolist()))})
        if point == best
        else point
        for point in results.points
    ]
    text = words_of(page_of(tmp_path, results.with_points(points)))
    assert f"{best.title} at {photons_text(best.photons)} photons, over all trials" in text
    assert text.count("87.5 12.5 8 ") == 1
    counts[1] = 0
    of_one = best.model_copy(update={"confusion": tuple(map(tuple, counts.tolist()))})
    text = words_of(page_of(tmp_path, results.with_points([of_one])))
    assert text.count("never tested") == 1
