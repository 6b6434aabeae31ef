"""The package's list holds valid jobs, and a collection is made design by design."""

import hashlib
import inspect
import json
import threading

import numpy as np
import pytest

from deepfsi import load_design
from deepfsi.datasets.arrays import from_arrays
from deepfsi.designfile.published import DESIGNS_VARIABLE
from deepfsi.sweeps import model_cards
from deepfsi.sweeps.model_cards import Collection
from deepfsi.training import learning

LIST = """
[designs.small]
recognises = "small digits"
data = "digits"
note = "Small."
settings = { photons = 1e4, masks = 4, epochs = 1, hidden = [8] }

[designs.looking]
recognises = "small digits"
data = "digits"
rescale = [0.0, 1.0]
settings = { design = "adaptive", photons = 1e3, masks = 2, clusters = 3 }

[data.digits]
citation = "Alpaydin and Kaynak"
licence = "CC BY 4.0"
"""


@pytest.fixture
def mine(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(LIST)
    return path


@pytest.mark.parametrize("name", Collection.read().designs)
def test_every_job_of_the_list_can_be_had_on_its_data(monkeypatch, name):
    """On scenes of their shape; each class has as many as its clusters need."""
    rng, usual = np.random.default_rng(2), inspect.signature(model_cards.load_dataset)

    def load(source, **options):
        usual.bind(source, **options)
        if source == "indian-pines":
            return from_arrays(rng.random((160, 256)), np.arange(160) % 16, name=source)
        x = np.tile(rng.random((20, 28, 28)), (300, 1, 1))
        return from_arrays(x, np.arange(6000) % 10, x[:20], np.arange(20) % 10, name=source)

    monkeypatch.setattr(model_cards, "load_dataset", load)
    recipe = Collection.read().designs[name]
    assert len(recipe.load().classes) == (16 if name.startswith("spectra") else 10)
    assert recipe.job.photons >= 1e4


def test_a_collection_is_made_once_and_opened_by_name(mine, done, tmp_path, monkeypatch):
    folder = tmp_path / "made"
    done("designs", "make", mine, "--only", "small", "-o", folder)
    first = (folder / "small.safetensors").stat().st_mtime_ns
    told = json.loads(done("designs", "make", mine, "-o", folder, "--json"))
    assert (folder / "small.safetensors").stat().st_mtime_ns == first  # there already
    monkeypatch.setenv(DESIGNS_VARIABLE, str(folder))
    assert json.loads(done("designs", "list", "--json"))["designs"] == told["designs"]
    assert load_design("looking").exposure.makes_masks
    assert load_design("small").info["data"]["origin"]["data"] == "digits"
    small = told["designs"]["small"]
    assert small["low"] < small["accuracy"] < small["high"]
    card = (folder / "small.md").read_text()
    content = (folder / "small.safetensors").read_bytes()
    accuracy = f"{small['accuracy']:.4f}, 95 % interval [{small['low']:.4f}, {small['high']:.4f}]"
    for words in (
        *("Alpaydin and Kaynak", "CC BY 4.0", "not for", "Divided by 16", "Small."),
        *(hashlib.sha256(content).hexdigest(), accuracy, "of 360 test scenes"),
        *("deepfsi designs make mine.toml --only small -o FOLDER", "masks = 4"),
    ):
        assert words in card
    assert "to [0.3, 1]" not in (folder / "looking.md").read_text()  # it was told otherwise


def test_what_is_spoilt_or_of_another_recipe_is_made_again(mine, done, tmp_path, monkeypatch):
    folder, usual, made = tmp_path / "made", learning.learn, []

    def learn(data, **settings):
        made.append(settings["masks"])
        return usual(data, **settings)

    monkeypatch.setattr(learning, "learn", learn)
    make = ("designs", "make", mine, "--only", "small", "-o", folder)
    done(*make)
    done(*make)
    assert made == [4]
    whole = (folder / "small.safetensors").read_bytes()
    (folder / "small.safetensors").write_bytes(whole[:-1])
    done(*make)
    assert made == [4, 4]
    mine.write_text(LIST.replace("masks = 4", "masks = 5"))
    done(*make)
    assert made == [4, 4, 5]


def test_ctrl_c_keeps_what_is_finished(mine, call, done, tmp_path, monkeypatch):
    folder, usual = tmp_path / "made", learning.learn

    def learn(data, **settings):
        if settings.get("design") == "adaptive":
            raise KeyboardInterrupt
        return usual(data, **settings)

    with monkeypatch.context() as stopping:
        stopping.setattr(learning, "learn", learn)
        # a process says it once
        stopping.setattr("deepfsi.base.interrupts._said", threading.Event())
        code, _, errors = call("designs", "make", mine, "-o", folder)
    assert code == 130
    assert "finished designs are kept" in errors
    names = {path.name for path in folder.iterdir()}
    assert names == {"small.safetensors", "small.md", "designs.json"}
    assert "small: there already" in done("designs", "make", mine, "-o", folder)
    assert (folder / "looking.md").exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("masks = 4", "maks = 4", "settings of small: a job has no setting 'maks'"),
        ('data = "digits"', 'data = "mnist"', "nothing says whose data small is trained on"),
        ("[designs.small]", '[designs."a/b"]', "designs.a/b"),
        ("--only", "smal", "did you mean 'small'"),
        ("--only", ",", "empty place"),
    ],
)
def test_a_bad_list_and_unknown_names_are_refused(mine, refuse, tmp_path, old, new, words):
    mine.write_text(LIST.replace(old, new, 1))
    only = (old, new) if old == "--only" else ()
    assert words in refuse("designs", "make", mine, *only, "-o", tmp_path / "made")
