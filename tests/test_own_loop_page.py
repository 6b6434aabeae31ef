"""The page on networks and loops of one's own is run, block by block, as libraries are there."""

import re
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import torch

PAGE = (Path(__file__).parent.parent / "docs/do/own-loop.md").read_text()
MODULE, *BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
NEEDED = {"lightning": "import lightning", "tensorboard": "SummaryWriter"}


@pytest.fixture(scope="module")
def names(tmp_path_factory):
    """What the blocks that need no further library leave behind."""
    names: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("page")
        (folder / "mynets.py").write_text(MODULE)
        patch.chdir(folder)
        patch.syspath_prepend(folder)
        torch.manual_seed(0)
        for block in BLOCKS:
            if not any(word in block for word in NEEDED.values()):
                exec(block.replace("=10, epochs=10", "=10, epochs=2"), names)
    sys.modules.pop("mynets")
    return names


def run(names, library):
    [block] = [block for block in BLOCKS if NEEDED[library] in block]
    exec(block, names)


@pytest.mark.slow
def test_networks_noises_and_loops_of_ones_own(names):
    assert names["accuracy"] > 0.8
    assert names["again"].name == names["design"].name
    assert names["results"][1].accuracy > 0.7
    assert names["plain"] > 0.85
    assert names["chances"].shape == (5, 10)


@pytest.mark.skipif(not find_spec("lightning"), reason="needs lightning: pip install lightning")
@pytest.mark.filterwarnings("ignore")  # those of lightning
def test_lightning(names):
    run(names, "lightning")
    assert names["lit"].masks == 12


@pytest.mark.slow
@pytest.mark.skipif(not find_spec("tensorboard"), reason="needs tensorboard: pip install it")
@pytest.mark.filterwarnings("ignore")  # those of tensorboard
def test_tensorboard(names, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run(names, "tensorboard")
    assert list(Path("runs/digits").glob("events*"))
    assert len(names["history"]) == 40
