"""The page of a study: what it says, and how it writes numbers."""

import pytest

from deepfsi.report import rendering
from deepfsi_paper.report import section as section_module
from deepfsi_paper.report.study_page import write_study
from shared.pages import (
    assert_explained,
    assert_headed,
    assert_whole,
    example,
)


def page_of(folder, sections) -> str:
    return write_study(folder, "Deep feature-specific imaging", sections).read_text("utf-8")


def section(**changes) -> section_module.Section:
    nothing = dict.fromkeys(("pictures", "claims", "tables", "files"), ())
    words = dict.fromkeys(("title", "found", "paper", "command"), "words")
    return section_module.Section(**{"name": "one", "facts": {}, **nothing, **words, **changes})


def test_page_is_one_self_contained_document(tmp_path):
    page = page_of(tmp_path / "out", example(tmp_path))
    files = {"photon-noise/accuracy.csv", "photon-noise/masks%2010.csv"}
    assert_whole(page, tmp_path / "out", files)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"figures", "report.html"}


@pytest.mark.usefixtures("undrawn")
def test_headings_are_in_order_and_abbreviations_explained(tmp_path):
    words = "PN: DFSI is above FSI and HB (AGN, RMSE 0.1); CGs and USERS are no such words"
    claim = section_module.Claim(words, True, "II − RS", "TH")
    table = section_module.Table("of CG", ("design",), (("DFSI",),))
    page = page_of(
        tmp_path, [*example(tmp_path), section(found=words, claims=(claim,), tables=(table,))]
    )
    assert_headed(page)
    assert_explained(page)
    assert '<abbr title="' + rendering.ABBREVIATIONS["PN"] in page
    assert "CGs and USERS" in page
    assert page.index("This page tests how well") < page.index("<h2") < page.index('class="sketch"')
