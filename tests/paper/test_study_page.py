"""The page of a study: what it says, and how it writes numbers."""

import numpy as np

from deepfsi.report.accuracy import accuracy_figure
from deepfsi.report.masks import masks_figure
from deepfsi_paper.report import section as section_module
from deepfsi_paper.report.study_page import write_study
from shared.pages import assert_whole
from shared.results import make_results


def test_page_is_one_self_contained_document(tmp_path):
    figures = (accuracy_figure(make_results(tmp_path)), masks_figure(np.eye(4, 16), (4, 4)))
    pictures = tuple(section_module.Picture(each, "words", "words") for each in figures)
    words = dict.fromkeys(("title", "found", "paper", "command"), "words")
    parts = {"pictures": pictures, "claims": (), "tables": (), "files": ("masks 10.csv",)}
    one = section_module.Section(name="one", data="digits", **words, **parts)
    page = write_study(tmp_path / "out", "A study", [one]).read_text("utf-8")
    assert_whole(page, tmp_path / "out", {"masks%2010.csv"})
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"figures", "report.html"}
