"""The page on training loops of one's own is run, block by block, as far as libraries are there."""

import re
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import torch

PAGE = (Path(__file__).parent.parent / "docs/do/own-loop.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
NEEDED = {"lightning": "import lightning", "tensorboard": "SummaryWriter"}


def run(names, library=None):
    """Run the blocks that need a library, or those that need none of them."""
    for block in BLOCKS:
        needs = [each for each, word in NEEDED.items() if word in block]
        if needs == ([] if library is None else [library]):
            exec(block, names)


@pytest.fixture
def names(tmp_path, monkeypatch):
    """Names that blocks with a library take from those before them."""
    monkeypatch.chdir(tmp_path)
    torch.manual_seed(0)
    names: dict[str, Any] = {}
    exec(BLOCKS[0], names)
    names["held"] = names["data"].hold_out()
    names["pairs"] = torch.utils.data.TensorDataset(names["photons"], names["y"])
    names["batches"] = torch.utils.data.DataLoader(names["pairs"], 64, shuffle=True)
    return names


def test_the_page_is_at_most_700_words_and_a_block_few_lines():
    assert len(PAGE.split()) <= 700
    assert max(block.count("\n") for block in BLOCKS) <= 24


@pytest.mark.slow
@pytest.mark.usefixtures("uncharacterised")
def test_plain_torch_and_what_learn_takes(names):
    run(names)
    assert names["plain"] > 0.85
    assert names["design"].masks == 12
    assert names["chances"].shape == (5, 10)
    assert len(names["brief"].info["history"]) == 3
    assert len(names["best"].info["history"]) <= 40
    assert names["other"].info["schedule"] == "cosine"


@pytest.mark.skipif(not find_spec("lightning"), reason="needs lightning: pip install lightning")
@pytest.mark.filterwarnings("ignore")  # those of lightning
def test_lightning(names):
    run(names, "lightning")
    assert names["lit"] > 0.85


@pytest.mark.slow
@pytest.mark.usefixtures("uncharacterised")
@pytest.mark.skipif(not find_spec("tensorboard"), reason="needs tensorboard: pip install it")
@pytest.mark.filterwarnings("ignore")  # those of tensorboard
def test_tensorboard(names):
    run(names, "tensorboard")
    assert list(Path("runs/digits").glob("events*"))
    assert len(names["history"]) == 40
