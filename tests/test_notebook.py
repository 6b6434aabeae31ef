"""The notebook runs from top to bottom, and its learned masks are better than PCA."""

import json
import re
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[1] / "docs/learn/notebook.ipynb"


@pytest.mark.slow
def test_all_cells_run(capsys):
    names: dict[str, object] = {}
    for cell in json.loads(NOTEBOOK.read_text())["cells"]:
        if cell["cell_type"] == "code":
            assert not cell["outputs"]
            exec("".join(cell["source"]), names)
    printed = capsys.readouterr().out
    learned, pca = map(float, re.findall(r"1e\+04.* (0\.\d+), PCA (0\.\d+)", printed)[0])
    assert learned > pca > 0.5
    assert "macro avg" in printed
