"""The page of a study: what it says, what it refuses, and how it writes numbers."""

import numpy as np
import pytest

from deepfsi.base import InputError
from deepfsi.report.rendering import ABBREVIATIONS
from deepfsi_paper.report.section import Claim, Section, Table
from deepfsi_paper.report.study_page import Shown, columns, write_study
from shared.pages import (
    SCRIPT,
    assert_explained,
    assert_headed,
    assert_whole,
    example,
    run_without_torch,
    words_of,
)


def page_of(folder, sections) -> str:
    return write_study(folder, "Deep feature-specific imaging", sections).read_text("utf-8")


def section(**changes) -> Section:
    nothing = dict.fromkeys(("pictures", "claims", "tables", "files"), ())
    words = dict.fromkeys(("title", "found", "paper", "command"), "words")
    return Section(**{"name": "one", "facts": {}, **nothing, **words, **changes})


def test_page_is_one_self_contained_document(tmp_path):
    page = page_of(tmp_path / "out", example(tmp_path))
    files = {"photon-noise/accuracy.csv", "photon-noise/masks%2010.csv"}
    assert_whole(page, tmp_path / "out", files)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"figures", "report.html"}


@pytest.mark.usefixtures("undrawn")
def test_everything_given_is_on_the_page(tmp_path):
    sections = example(tmp_path)
    page = page_of(tmp_path, sections)
    text = words_of(page).replace("&lt;", "<").replace("&gt;", ">")
    for part in sections:
        for words in (part.title, part.found, part.paper, part.command):
            assert words in text
        for picture in part.pictures:
            assert picture.caption in text
            assert f'aria-label="{picture.words}"' in page
        for claim in part.claims:
            assert text.count(claim.text) >= 2
            assert text.count(claim.measured) >= 2
            assert text.count(claim.why) >= 2
        for table in part.tables:
            assert table.caption in text
    assert "versions.torch 2.13.0" in text
    assert "device.instructions avx512f, amx_bf16" in text


@pytest.mark.usefixtures("undrawn")
def test_claims_are_counted(tmp_path):
    text = words_of(page_of(tmp_path, example(tmp_path)))
    assert "2 experiments. Claims tested: 11; 3 hold, 4 do not, 4 open." in text
    assert "Accuracy under photon noise 3 hold, 3 do not, 3 open" in text
    assert "1 does not, 1 open" in text
    quiet = words_of(page_of(tmp_path, [section()]))
    assert "1 experiment. Each experiment" in quiet
    assert "claim" not in quiet.lower()


@pytest.mark.usefixtures("undrawn")
def test_headings_are_in_order_and_abbreviations_explained(tmp_path):
    words = "PN: DFSI is above FSI and HB (AGN, RMSE 0.1); CGs and USERS are no such words"
    claim = Claim(words, True, "II − RS", "TH")
    table = Table("of CG", ("design",), (("DFSI",),))
    page = page_of(
        tmp_path, [*example(tmp_path), section(found=words, claims=(claim,), tables=(table,))]
    )
    assert_headed(page)
    assert_explained(page)
    assert '<abbr title="' + ABBREVIATIONS["PN"] in page
    assert "CGs and USERS" in page
    assert page.index("This page tests how well") < page.index("<h2") < page.index('class="sketch"')


@pytest.mark.usefixtures("undrawn")
def test_markup_is_text(tmp_path):
    page = page_of(tmp_path, [*example(tmp_path), section(title=SCRIPT, command=SCRIPT)])
    assert SCRIPT not in page
    assert page.count("<script>") == 1
    bad = write_study(tmp_path, SCRIPT, [section()]).read_text("utf-8")
    assert SCRIPT not in bad


def test_a_file_cannot_be_an_address_of_another_kind(tmp_path):
    page = page_of(tmp_path, [section(files=("javascript:alert(1)", 'a".csv'))])
    assert 'href="javascript%3Aalert%281%29"' in page
    assert 'href="a%22.csv"' in page


def test_same_study_makes_the_same_page(tmp_path):
    pages = {page_of(tmp_path, example(tmp_path)[1:]) for _ in range(2)}
    assert len(pages) == 1


@pytest.mark.parametrize(
    ("column", "texts"),
    [
        ((0.9, 0.85, 1.0), ["0.900", "0.850", "1.000"]),
        ((0.0123, -0.0045, 0.0), ["0.0123", "−0.0045", "0.0000"]),
        ((1e2, 1e4, 3e5, 0.0), ["100", "10⁴", "3 × 10⁵", "0"]),
        ((5321.7, 12.0), ["5322", "12"]),
        ((12.34, 1.0), ["12.34", "1.00"]),
        ((20260101, -3), ["20260101", "−3"]),
        ((1.5e-7, -2e9, 9.999e-4), ["1.5 × 10⁻⁷", "−2 × 10⁹", "10⁻³"]),
        ((np.float32(0.5), np.int64(70000)), ["0.500", "70000"]),
        ((None, float("nan"), 0.5), ["–", "–", "0.500"]),
        ((float("inf"), float("-inf")), ["∞", "−∞"]),
        (("words", 3, None), ["words", "3", "–"]),
    ],
)
def test_numbers_are_written_as_people_do(column, texts):
    words, rows = columns(Table("", ("a",), tuple((cell,) for cell in column)))
    assert [cell.text for (cell,) in rows] == texts
    assert words == ["words" in column]


def test_cells_sort_by_their_whole_value():
    row = (0.123456789, 10**7, None, "words", float("inf"))
    _, [cells] = columns(Table("", ("a", "b", "c", "d", "e"), (row,)))
    assert [cell.value for cell in cells] == ["0.123456789", "10000000", None, None, "Infinity"]
    assert cells[2] == Shown("–")


@pytest.mark.parametrize(
    ("sections", "told"),
    [
        ([], "without sections"),
        ([section(name="a b")], "'a b': use letters"),
        ([section(name="")], "use letters"),
        ([section(), section()], "two sections named 'one'"),
        ([section(files=("/data/a.csv",))], "does not lie beside the page"),
        ([section(files=("../a.csv",))], "does not lie beside the page"),
        ([section(tables=(Table("t", ("a", "b"), ((1,),)),))], "do not fit its 2 heads"),
    ],
)
def test_studies_that_cannot_be_a_page_are_refused(tmp_path, sections, told):
    with pytest.raises(InputError, match=told):
        write_study(tmp_path, "title", sections)
    assert not list(tmp_path.iterdir())


def test_study_needs_no_torch(tmp_path):
    code = (
        "from deepfsi_paper.report.section import Section; "
        "from deepfsi_paper.report.study_page import write_study; "
        "write_study(sys.argv[1], 't', [Section('a', *'bcd', (), (), (), (), 'e', {})])"
    )
    run_without_torch(code, tmp_path)
    assert (tmp_path / "report.html").is_file()
