"""Each figure of a report stands on its page and beside it, as files that one can publish."""

import re

from deepfsi.report import write_report
from shared.results import make_results

BEGINNINGS = {"svg": b"<?xml", "pdf": b"%PDF-", "png": b"\x89PNG"}


def test_every_figure_of_the_page_is_beside_it_in_three_formats(tmp_path):
    make_results(tmp_path)
    page = write_report(tmp_path).read_text()
    assert re.findall(r'href="(figures/[^"]*)"', page) == ["figures/"]
    files = [*(tmp_path / "figures").iterdir()]
    assert len(files) == 3 * page.count('class="drawing"') > 9
    for file in files:
        assert file.read_bytes().startswith(BEGINNINGS[file.suffix[1:]])
