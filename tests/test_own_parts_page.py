"""The pages on your own classifier, noise and optics are run, block by block, in one folder."""

import re
import shlex
import sys
import tomllib
from pathlib import Path

from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.trial import plan

DO = Path(__file__).parent.parent / "docs/do"
PAGE = "".join((DO / f"own-{part}.md").read_text() for part in ("classifier", "noise", "optics"))
MODULE, *BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
LINES = re.findall(r"^deepfsi .*$", PAGE.replace("\\\n", ""), flags=re.MULTILINE)
BRIEFLY = {"design": "--epochs 1", "compare": "--epochs 1 --designs pca --masks 3"}
TABLES = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)


def test_the_pages_on_your_own_parts(tmp_path, monkeypatch, done):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mynets.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    names: dict[str, object] = {}
    for block in BLOCKS:
        exec(block, names)
    assert names["accuracy"] > 0.8
    assert names["mine"] > 0.7
    assert names["measured"] > 0.7
    assert names["results"][1].accuracy > 0.7
    for line in LINES:
        done(*shlex.split(line)[1:], *BRIEFLY.get(line.split()[1], "").split())
    for table in TABLES:
        assert plan(Recipe(**tomllib.loads(table), designs="pca"), names["data"])
    sys.modules.pop("mynets")
