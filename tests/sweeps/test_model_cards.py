"""The package's list holds valid jobs, and a collection is made design by design."""

import gzip
import hashlib
import json
import threading
from functools import cache

import numpy as np
import pytest

from deepfsi import load_design, training
from deepfsi.datasets import from_arrays
from deepfsi.datasets.catalog import DATASETS
from deepfsi.designfile.published import DESIGNS_VARIABLE
from deepfsi.sweeps import Collection, model_cards

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


def idx_gz(array):
    """A gzipped idx file of an array of bytes."""
    lengths = np.array(array.shape, ">u4").tobytes()
    return gzip.compress(bytes([0, 0, 8, array.ndim]) + lengths + array.tobytes())


@cache
def idx_files():
    """Files in MNIST's format: 600 training images of each class, as 300 clusters need."""
    drawn = np.random.default_rng(1).integers(0, 256, (20, 28, 28), dtype=np.uint8)
    images, labels = np.tile(drawn, (301, 1, 1)), np.arange(6020, dtype=np.uint64) % 10
    labels = labels.astype(np.uint8)
    parts = (images[20:], labels[20:], images[:20], labels[:20])
    return dict(zip(DATASETS["mnist"].hashes, map(idx_gz, parts), strict=True))


@pytest.fixture
def stand_ins(tmp_path, monkeypatch):
    """Small data in the place, and in the format, of those that the package's list names."""
    rng, contents = np.random.default_rng(2), idx_files()
    hashes = {name: f"md5:{hashlib.md5(file).hexdigest()}" for name, file in contents.items()}
    for name in ("mnist", "fashion-mnist"):
        (tmp_path / name).mkdir()
        for file, content in contents.items():
            (tmp_path / name / file).write_bytes(content)
        monkeypatch.setattr(DATASETS[name], "hashes", hashes)
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    spectra = from_arrays(rng.random((160, 256)), np.arange(160) % 16, name="spectra")
    usual = model_cards.load_dataset

    def load(source, **options):
        return spectra if source == "indian-pines" else usual(source, **options)

    monkeypatch.setattr(model_cards, "load_dataset", load)


@pytest.mark.parametrize("name", Collection.read().designs)
def test_every_job_of_the_list_can_be_had_on_its_data(stand_ins, name):
    recipe = Collection.read().designs[name]
    data = recipe.load()
    assert len(data.classes) == (16 if name.startswith("spectra") else 10)
    assert recipe.job.photons >= 1e4


def test_the_list_has_the_six():
    designs = Collection.read().designs
    assert list(designs) == [
        *("dmd-mnist", "dmd-2x2-mnist", "adaptive-mnist", "click-mnist"),
        *("dmd-fashion-mnist", "spectra-indian-pines"),
    ]
    assert designs["click-mnist"].job.camera.noise_name == "click"
    assert designs["dmd-2x2-mnist"].job.camera.detectors == "2x2"


def test_a_collection_is_made_once_and_opened_by_name(mine, done, tmp_path, monkeypatch):
    folder = tmp_path / "made"
    done("designs", "make", mine, "--only", "small", "-o", folder)
    first = (folder / "small.safetensors").stat().st_mtime_ns
    told = json.loads(done("designs", "make", mine, "-o", folder, "--json"))
    assert (folder / "small.safetensors").stat().st_mtime_ns == first  # there already
    monkeypatch.setenv(DESIGNS_VARIABLE, str(folder))
    listed = json.loads(done("designs", "list", "--json"))
    assert listed["designs"] == told["designs"]
    assert (told["schema"], listed["schema"]) == (
        "deepfsi.designs.make/1",
        "deepfsi.designs.list/1",
    )
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
    folder, usual, made = tmp_path / "made", training.learn, []

    def learn(data, **settings):
        made.append(settings["masks"])
        return usual(data, **settings)

    monkeypatch.setattr(training, "learn", learn)
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
    folder, usual = tmp_path / "made", training.learn

    def learn(data, **settings):
        if settings.get("design") == "adaptive":
            raise KeyboardInterrupt
        return usual(data, **settings)

    with monkeypatch.context() as stopping:
        stopping.setattr(training, "learn", learn)
        stopping.setattr(
            "deepfsi.base.interrupts._said", threading.Event()
        )  # a process says it once
        code, _, errors = call("designs", "make", mine, "-o", folder)
    assert code == 130
    assert "finished designs are kept" in errors
    assert {path.name for path in folder.iterdir()} == {
        *("small.safetensors", "small.md", "designs.json"),
    }
    assert "small: there already" in done("designs", "make", mine, "-o", folder)
    assert (folder / "looking.md").exists()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("masks = 4", "maks = 4", "settings of small: a job has no setting 'maks'"),
        ('data = "digits"', 'data = "mnist"', "nothing says whose data small is trained on"),
        ("[designs.small]", '[designs."a/b"]', "designs.a/b"),
    ],
)
def test_a_bad_list_is_refused_before_any_work(mine, refuse, tmp_path, old, new, words):
    mine.write_text(LIST.replace(old, new, 1))
    assert words in refuse("designs", "make", mine, "-o", tmp_path / "made")


@pytest.mark.parametrize(
    ("only", "words"), [("smal", "did you mean 'small'"), (",", "empty place")]
)
def test_unknown_names_are_refused(mine, refuse, tmp_path, only, words):
    assert words in refuse("designs", "make", mine, "--only", only, "-o", tmp_path / "made")
