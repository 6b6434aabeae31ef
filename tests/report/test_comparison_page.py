"""The page of a comparison needs nothing else, and says what the numbers say."""

import json
import re

import numpy as np
import pytest
from markupsafe import escape

from deepfsi.base import InputError
from deepfsi.report import LAW_TERMS, accuracy_figure, verdict_of, write_report
from deepfsi.report.comparison_page import compared_text, covers_text, summary_text
from deepfsi.report.rendering import DESIGN_TERMS
from deepfsi.sweeps import write_results
from shared.pages import assert_explained, assert_headed, assert_whole, run_without_torch, words_of
from shared.results import make_results, with_all


def page_of(folder):
    return write_report(folder).read_text(encoding="utf-8")


words_alone = pytest.mark.usefixtures("undrawn")
"""Tests of words beside figures, which then count none of a figure's."""


def test_page_is_one_self_contained_document(tmp_path):
    make_results(tmp_path, noises=("poisson", "gaussian"))
    assert_whole(page_of(tmp_path), tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "designs",
        "figures",
        "report.html",
        "results.json",
    ]


@words_alone
def test_all_designs_and_numbers_are_in_the_tables(tmp_path):
    results = make_results(tmp_path)
    text = words_of(page_of(tmp_path))
    for point in results.points:
        assert f"{point.accuracy:.3f}" in text
        assert f"{point.low:.3f}" in text
        assert f"{point.high:.3f}" in text
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


@words_alone
@pytest.mark.parametrize("noise", ["poisson", "click"])
def test_clicks_stand_beside_the_photons_that_arrive(tmp_path, noise):
    """Photon counts are the photons that arrive, and need no second column."""
    light = {"noise": noise, "counts": 28.4, "arriving": 94.9 if noise == "click" else 28.4}
    results = make_results(tmp_path)
    points = [point.model_copy(update=light) for point in results.points]
    write_results(tmp_path / "results.json", results.with_points(points))
    page = page_of(tmp_path)
    assert ("28.4 clicks of 94.9 photons that arrive" in page) == (noise == "click")
    assert ('<td data-value="94.9">94.9</td>' in page) == (noise == "click")
    assert ("arriving" in page) == (noise == "click")


@words_alone
def test_masks_are_named_by_the_budget_that_they_learned_at(tmp_path):
    """Tested at several budgets and grey levels, the file of a design is drawn once, as it is."""
    results = make_results(tmp_path, designs=("deepfsi",))
    [learned, *_] = [p for p in results.points if p.best and p.photons == 1e4]
    tested = [
        learned.model_copy(update={"photons": photons, "levels": levels})
        for photons in (1e2, 1e4, 1e6)
        for levels in (0, 2)
    ]
    write_results(tmp_path / "results.json", results.with_points(tested))
    page = page_of(tmp_path)
    assert page.count("Masks learned at 10⁴ photons") == 1
    assert "Masks learned at 100 photons" not in page


@words_alone
def test_detectors_and_what_is_read_stand_in_tables_and_names(tmp_path):
    """Where a design has several; the grid of the others stands where it tells two apart."""
    results = make_results(tmp_path, designs=("impulse", "pca"))
    tiles = [
        p.model_copy(update={"detectors": detectors, "readout": readout, "light": "two-arm"})
        for p in results.points
        if p.design == "pca"
        for detectors in ("1x1", "2x2")
        for readout in ("difference", "both")
    ]
    whole = [p for p in results.points if p.design == "impulse"]
    write_results(tmp_path / "results.json", results.with_points([*whole, *tiles]))
    text = words_of(page_of(tmp_path))
    assert "with one detector" not in text
    for told in (
        "two-arm, dual, 2x2 detectors, both read",
        "two-arm, dual, both read",
        " ) 2x2 detectors difference",
        " ) 1x1 detectors both",
    ):
        assert told in text


@words_alone
def test_sections_come_in_order(tmp_path):
    make_results(tmp_path)
    titles = re.findall(r"<h2>(.*?)</h2>", page_of(tmp_path))
    assert titles == [
        "What to do next",
        "Best number of masks at each budget",
        "Accuracy and number of masks",
        "Learned masks and the distribution of their values",
        "All results",
        "How to repeat it",
        "Provenance",
        "Terms and abbreviations",
    ]


@words_alone
def test_a_page_opens_with_what_is_compared(tmp_path):
    results = make_results(tmp_path)
    text = compared_text(results)
    assert text.startswith("5 ways to choose a camera’s masks, at equal light (light law column): ")
    assert "360 test scenes of digits" in text
    said = covers_text(results)
    assert "Impulse imaging, with a detector for each of the 24 pixels, reaches 0.796" in said
    assert "The intervals are of 95 % and cover seeds of training (t over 3 trials)." in said
    page = page_of(tmp_path)
    assert page.count("<li>") == 4
    assert page.index("<h1>") < page.index('class="plot"') < page.index("<h2") < page.index("<li>")
    assert '<a href="figures/">' in page
    single = results.with_points(p for p in results.points if p.design != "impulse")
    assert "mpulse" not in compared_text(single) + covers_text(single)
    assert "adaptive" not in said
    adaptive = [p.model_copy(update={"design": "adaptive"}) for p in single.points]
    beside = results.with_points([*results.points, *adaptive])
    assert "adaptive masks can be above impulse imaging" in covers_text(beside)


@words_alone
def test_what_to_do_next_is_a_command(tmp_path):
    make_results(tmp_path)
    assert "deepfsi compare -o runs/dmd --camera dmd --data digits" in words_of(page_of(tmp_path))
    results = make_results(tmp_path / "dmd", lights=("free-dwell",))
    [file] = re.findall(r"deepfsi dmd export designs/(\S+)", page_of(tmp_path / "dmd"))
    assert (tmp_path / "dmd" / "designs" / file).is_file()
    assert file == f"{verdict_of(results).best.keys[0]}.safetensors"
    assert f"deepfsi page designs/{file} -o page.html" in words_of(page_of(tmp_path / "dmd"))
    for kept in (tmp_path / "dmd" / "designs").iterdir():
        kept.unlink()
    assert "deepfsi design --masks 16" in words_of(page_of(tmp_path / "dmd"))


@words_alone
def test_each_design_and_light_law_of_the_page_is_a_term(tmp_path):
    results = make_results(tmp_path, lights=("column", "two-arm"))
    text = words_of(page_of(tmp_path)).partition("Terms and abbreviations")[2]
    for point in results.points:
        assert f" {point.title} " in text
        assert str(escape(DESIGN_TERMS[point.design])) in text
        assert f"{point.light} , {escape(LAW_TERMS[point.light])}" in text
    assert "free-dwell" not in text


@words_alone
def test_provenance_has_no_row_of_what_was_not_set(tmp_path):
    recipe = {"size": None, "ratios": [], "balance": False, "lr": 5e-3, "name": ""}
    make_results(tmp_path, recipe=recipe)
    page = page_of(tmp_path)
    assert "None" not in words_of(page)
    for name, value in {"balance": "no", "lr": "0.005"}.items():
        assert f"<dt>{name}</dt><dd>{value}</dd>" in page
    assert not re.findall("<dt>(?:size|ratios|name)</dt><dd>(?!digits)", page)
    assert "not set" not in page


@words_alone
def test_a_cell_holds_one_number_and_its_interval_and_the_others_in_its_tip(tmp_path):
    results = make_results(tmp_path, budgets=(1e3,))
    page = page_of(tmp_path)
    for p in (p for p in results.points if p.best):
        [tip, shown] = re.findall(
            rf'<td title="([^"]*)"><span[^>]*>{p.accuracy:.3f}</span><small>(.*?)</small>', page
        )[0]
        assert shown == f"{p.low:.3f}–{p.high:.3f}"
        assert f"balanced {p.balanced:.3f}" in tip
        assert f"{p.masks} mask" in tip
        assert f"{p.counts:g} counts" in tip
    assert "Beside them: how the values" in page


def test_summary_follows_the_numbers(tmp_path):
    results = make_results(tmp_path)
    text = summary_text(results, "poisson")
    assert text.startswith(
        "Under photon noise: DeepFSI is the most accurate at 100 and 10⁴ photons: "
        "0.706 (0.702–0.710) at 100 with 4 masks and "
    )
    assert "told apart" not in text
    wide = summary_text(with_all(results, low=0.0, high=1.0), "poisson")
    assert "most accurate" not in wide
    assert "PCA (FSI)" in wide
    assert "cannot be told apart on the same test scenes: they reach 0." in wide
    few = [
        p.model_copy(update={"low": 0.5}) if (p.design, p.photons) == ("deepfsi", 1e2) else p
        for p in results.points
    ]
    text = summary_text(results.with_points(few), "poisson")
    assert "At 100 photons DeepFSI and PCA (FSI) cannot be told apart" in text
    assert "DeepFSI is the most accurate at 10⁴ photons" in text


def test_the_verb_of_adaptive_masks_is_plural(tmp_path):
    results = make_results(tmp_path, designs=("pca", "deepfsi"))
    points = [
        p.model_copy(update={"design": "adaptive", "title": "adaptive masks"})
        if p.design == "deepfsi"
        else p
        for p in results.points
    ]
    assert "Adaptive masks are the most accurate" in summary_text(
        results.with_points(points), "poisson"
    )
    alone = summary_text(
        results.with_points(p for p in points if p.design == "adaptive"), "poisson"
    )
    assert "Adaptive masks reach 0.7" in alone


ONE = "one detector"


@words_alone
@pytest.mark.parametrize(
    ("light", "said"),
    [
        ("column", "with a detector for each readout, which no single mirror device does"),
        ("free-dwell", "A camera with one detector: each mask in turn"),
        ("two-arm", "Each mask sends a part of the scene’s Φ photons to a detector."),
    ],
)
def test_one_detector_is_said_of_the_optics_that_have_one(tmp_path, light, said):
    results = make_results(tmp_path, lights=(light,))
    text = words_of(page_of(tmp_path))
    assert said in text
    assert (ONE in text) == (ONE in summary_text(results, "poisson")) == (light == "free-dwell")
    tiles = with_all(results, detectors="2x2")
    write_results(tmp_path / "results.json", tiles)
    assert ONE not in words_of(page_of(tmp_path))
    single = results.with_points(p for p in results.points if p.design != "impulse")
    assert "impulse imaging" not in summary_text(single, "poisson")


@words_alone
@pytest.mark.parametrize("rails", ["single", "dual"])
def test_the_sketch_and_the_words_are_of_the_rails_that_the_masks_have(tmp_path, rails):
    """Masks of a single rail have no negative entries, and nothing counts them."""
    results = with_all(make_results(tmp_path, lights=("free-dwell",)), rails=rails)
    write_results(tmp_path / "results.json", results)
    page, two = page_of(tmp_path), rails == "dual"
    [sketch] = re.findall('<figure class="camera">.*?</figure>', page, re.DOTALL)
    assert ("rails + and −" in sketch) == two
    assert ("negative part" in sketch) == two
    assert ("var(--pca)" in sketch) == two
    assert ("negative ones, where it has any" in sketch) == two
    assert ("No entry of a mask is negative" in sketch) == (not two)
    assert ("negative ones by the other" in words_of(page)) == two
    assert "Impulse imaging has no masks" in sketch
    write_results(
        tmp_path / "results.json",
        results.with_points(p for p in results.points if p.design != "impulse"),
    )
    assert "Impulse imaging" not in page_of(tmp_path).partition("</figure>")[0]


@words_alone
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
    assert names == {"impulse imaging", "DeepFSI column", "DeepFSI free-dwell"}
    page = page_of(tmp_path)
    assert page.count("Accuracy against number of masks at") == 4
    text = words_of(page)
    assert "DeepFSI free-dwell, Gaussian read noise" in text


@pytest.mark.usefixtures("drawn_once")
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
    assert_headed(page)
    assert_explained(page)
    assert ("<h2>Learned masks" in page) == any(p.learned for p in results.points)
    several = len({p.masks for p in results.points if p.design in ("pca", "deepfsi")}) > 1
    assert ("<h2>Accuracy and number of masks" in page) == several
    assert ("nothing was chosen" in page) == (results.chosen_on == "nothing")


@words_alone
def test_designs_that_were_not_kept_are_said_to_be_missing(tmp_path):
    make_results(tmp_path)
    for file in (tmp_path / "designs").iterdir():
        file.unlink()
    assert "design files of this comparison are not in its folder" in page_of(tmp_path)


@pytest.mark.usefixtures("drawn_once")
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


def test_same_results_make_the_same_page_and_figures(tmp_path):
    make_results(tmp_path, designs=("deepfsi",))
    first, second = (
        [page_of(tmp_path), *(path.read_bytes() for path in sorted(tmp_path.glob("figures/*")))]
        for _ in range(2)
    )
    assert first == second
    assert len(first) == 1 + 3 * first[0].count('class="drawing"') > 1


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (None, "no results in"),
        ("{", r"cannot be used: .*; run the comparison again"),
        ("[]", r"cannot be used: .*; run the comparison again"),
        ({"schema": 6, "points": []}, "upgrade deepfsi"),
        (
            {"schema": 1, "points": []},
            "with schema 1, older than the files that are read: run the comparison again",
        ),
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
        write_report(tmp_path)
    assert not (tmp_path / "report.html").exists()


@words_alone
def test_damaged_design_file_is_named(tmp_path):
    make_results(tmp_path)
    for file in (tmp_path / "designs").iterdir():
        file.write_bytes(b"no design")
    with pytest.raises(InputError, match=r"poisson-column-deepfsi-100-4\.safetensors"):
        write_report(tmp_path)


def test_report_needs_no_torch(tmp_path):
    make_results(tmp_path)
    run_without_torch(
        "from deepfsi.report import write_report; write_report(sys.argv[1])", tmp_path
    )


@words_alone
def test_equal_designs_are_all_named_and_bold_and_those_of_one_class_are_marked(tmp_path):
    results = make_results(tmp_path, designs=("pca", "deepfsi", "truncated-hadamard"))
    data = results.data.model_copy(update={"chance": 0.891})
    equal = with_all(results, accuracy=0.891, low=0.8, high=0.95, one_class=True)
    equal = equal.model_copy(update={"data": data})
    text = summary_text(equal, "poisson")
    for told in (
        "truncated Hadamard, PCA (FSI) and DeepFSI cannot be told apart",
        "they reach 0.891 to 0.891",
        "PCA (FSI) at 100 photons answers one class only",
    ):
        assert told in text
    assert "Chance is 0.891, the share of the commonest class" in covers_text(equal)
    write_results(tmp_path / "results.json", equal)
    page = page_of(tmp_path)
    assert page.count('class="first"') == 6
    assert page.count("answers one class only</small>") == 6
    heights = {line.get_ydata()[0] for line in accuracy_figure(equal).axes[0].lines}
    assert 0.891 in heights
    assert 0.1 not in heights


def test_confusion_matrices_are_those_of_the_chosen_mask_counts(tmp_path):
    results = make_results(tmp_path, designs=("raster", "pca"))
    assert "taken for which" not in page_of(tmp_path), "results of before have none"
    counts = np.eye(len(results.data.classes), dtype=int)
    counts[0, :2] = 7, 1
    matrix = tuple(map(tuple, counts.tolist()))
    points = [
        point.model_copy(update={"confusion": matrix if point.best else ()})
        for point in results.points
    ]
    write_results(tmp_path / "results.json", results.with_points(points))
    page = page_of(tmp_path)
    chosen = [point for point in points if point.best]
    assert page.count("<table class='confusion'>") == len(chosen) > 1
    hidden = re.findall(r'<div class="scroll matrix" id="(\S+)"[^>]* hidden>', page)
    [opened] = re.findall(r'<option value="(\S+)" selected>PCA \(FSI\), 100 photons', page)
    assert verdict_of(results).photons == 100
    assert len(hidden) == len(chosen) - 1
    assert opened not in hidden
    assert words_of(page).count("87.5 12.5") == len(chosen)
    assert_whole(page, tmp_path)
    assert_headed(page)
    points[0] = points[0].model_copy(update={"confusion": ((1, 2),), "best": True})
    write_results(tmp_path / "results.json", results.with_points(points))
    with pytest.raises(InputError, match="not of the data's classes"):
        page_of(tmp_path)
