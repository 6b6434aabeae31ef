"""Each figure of a report stands on its page and beside it, as files that one can publish."""

import re

from deepfsi.report.comparison_page import build
from shared.results import make_results

BEGINNINGS = {"svg": b"<?xml", "pdf": b"%PDF-", "png": b"\x89PNG"}


def test_every_figure_of_the_page_is_beside_it_in_three_formats(tmp_path):
    make_results(tmp_path)
    page = build(tmp_path).read_text()
    files = re.findall(r'href="(figures/[^"]*)"', page)
    assert len(files) == 3 * page.count('class="drawing"') > 9
    assert {f"figures/{path.name}" for path in (tmp_path / "figures").iterdir()} == {*files}
    for file in files:
        assert (tmp_path / file).read_bytes().startswith(BEGINNINGS[file.rpartition(".")[2]])
