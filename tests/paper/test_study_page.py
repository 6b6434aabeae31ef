"""The page of a study: what it says, and how it writes numbers."""

import numpy as np

from deepfsi.report.accuracy import accuracy_figure
from deepfsi.report.masks import masks_figure
from deepfsi_paper.report import section as section_module
from deepfsi_paper.report.study_page import write_study
from shared.pages import assert_headed, assert_whole
from shared.results import make_results


def section(**changes) -> section_module.Section:
    nothing = dict.fromkeys(("pictures", "claims", "tables", "files"), ())
    words = dict.fromkeys(("title", "found", "paper", "command"), "words")
    return section_module.Section(
        **{"name": "one", "data": "digits", **nothing, **words, **changes}
    )


def test_page_is_one_self_contained_document(tmp_path):
    figures = (accuracy_figure(make_results(tmp_path)), masks_figure(np.eye(4, 16), (4, 4)))
    pictures = tuple(section_module.Picture(each, "words", "words") for each in figures)
    sections = [section(pictures=pictures, files=("masks 10.csv",))]
    page = write_study(tmp_path / "out", "A study", sections).read_text("utf-8")
    assert_whole(page, tmp_path / "out", {"masks%2010.csv"})
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"figures", "report.html"}


def test_headings_are_in_order(tmp_path):
    claim = section_module.Claim("PN: DFSI is above FSI", True, "II − RS", "TH")
    table = section_module.Table("of CG", ("design",), (("DFSI",),))
    sections = [section(), section(claims=(claim,), tables=(table,))]
    page = write_study(tmp_path, "Deep feature-specific imaging", sections).read_text("utf-8")
    assert_headed(page)
    assert "<dt>PN</dt><dd>photon noise" in page
