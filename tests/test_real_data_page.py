"""The page of real data: its lines print what it says, where the data are."""

import os
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[1] / "docs/notebook/real-data.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```\n\n((?:    [^\n]*\n)+)", PAGE, flags=re.DOTALL)
DATA = Path(os.environ.get("DEEPFSI_DATA") or ".")


@pytest.mark.parametrize(
    ("place", "folder"),
    [(0, "spc_photon_counter"), (1, "spc_wavelet"), (2, "spc_modes"), (3, "ptu")],
)
def test_lines_print_what_the_page_says(place, folder, capsys, monkeypatch):
    if not (DATA / folder).exists():
        pytest.skip(f"needs $DEEPFSI_DATA/{folder}")
    monkeypatch.chdir(DATA)
    code, said = BLOCKS[place]
    assert code.count("\n") <= 30
    exec(code, {})
    assert capsys.readouterr().out == re.sub(r"^    ", "", said, flags=re.MULTILINE)
