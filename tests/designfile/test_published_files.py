"""Published designs are opened by name, from a folder or an address, as their index says."""

import functools
import hashlib
import http.server
import json
import shutil
import threading
from dataclasses import replace
from pathlib import Path

import pooch
import pytest

from conftest import real_mnist
from deepfsi import evaluate, load_dataset, load_design
from deepfsi.base.errors import InputError
from deepfsi.designfile.published import (
    INDEX_NAME,
    SHIPPED_DESIGNS,
    CollectionIndex,
    PublishedDesign,
    find_design,
    read_indexes,
)
from deepfsi.sweeps.model_cards import Collection


@pytest.fixture
def collection(made, tmp_path, monkeypatch):
    """Folder with one design, `small`; nothing is cached, and nothing is in the way of its name."""
    folder = tmp_path / "collection"
    content = made("pca", "column", "dual").to_bytes()
    folder.mkdir()
    (folder / "small.safetensors").write_bytes(content)
    index(folder, hashlib.sha256(content).hexdigest())
    monkeypatch.setattr(pooch, "os_cache", lambda _: tmp_path / "cache")
    monkeypatch.setenv("DEEPFSI_DESIGNS", str(folder))
    monkeypatch.chdir(tmp_path)
    return folder


def index(folder, sha256):
    numbers = {"photons": 1e4, "accuracy": 0.5, "low": 0.4, "high": 0.6}
    entry = PublishedDesign(sha256=sha256, recognises="it", data="it", recipe="0" * 64, **numbers)
    (folder / INDEX_NAME).write_text(CollectionIndex(designs={"small": entry}).model_dump_json())


@pytest.fixture
def address(collection, monkeypatch):
    """Address that serves the folder; gives the paths that were asked for."""
    asked = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            asked.append(self.path)

    serving = functools.partial(Handler, directory=str(collection))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), serving) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        monkeypatch.setenv("DEEPFSI_DESIGNS", f"http://127.0.0.1:{server.server_port}/")
        yield asked
        server.shutdown()


def test_an_address_is_asked_for_a_file_once(address, collection, tmp_path):
    path = find_design("small")
    assert path.parent == tmp_path / "cache" / "designs"
    assert path.read_bytes() == (collection / "small.safetensors").read_bytes()
    assert load_design("small").name == "pca"
    assert address.count("/small.safetensors") == 1
    path.write_bytes(b"spoilt")
    assert load_design("small").name == "pca"  # brought again
    assert address.count("/small.safetensors") == 2


def test_a_file_of_another_hash_is_refused_and_not_kept(address, collection, tmp_path, monkeypatch):
    index(collection, "0" * 64)
    with pytest.raises(InputError, match=r"small.safetensors \(wrong hash\), and nothing of it"):
        load_design("small")
    assert not list((tmp_path / "cache").rglob("*.*"))
    monkeypatch.setenv("DEEPFSI_DESIGNS", str(collection))
    with pytest.raises(InputError, match=r"wrong sha256.*make it again"):
        load_design("small")


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ("", "no published design 'smal': .*or set DEEPFSI_DESIGNS to the folder"),
        ("collection", "no published design 'smal': did you mean 'small'"),
        ("nowhere", f"nowhere/{INDEX_NAME} is missing: give the folder of a collection"),
        ("ftp://a.example", "give a folder, or an address of http, https or file"),
        ("http://127.0.0.1:9", f"cannot download http://127.0.0.1:9/{INDEX_NAME} .ConnectionError"),
    ],
)
def test_what_cannot_be_found_is_said_in_one_line(collection, monkeypatch, where, words):
    monkeypatch.setenv("DEEPFSI_DESIGNS", where)
    with pytest.raises(InputError, match=words):
        load_design("smal")


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        ("{", "make the collection again"),
        ('{"designs": {"../a": {}}}', "make the collection again"),
        ('{"schema_version": 2}', "newer than this one: upgrade deepfsi"),
    ],
)
def test_a_spoilt_index_is_refused(collection, spoilt, said):
    (collection / INDEX_NAME).write_text(spoilt)
    with pytest.raises(InputError, match=f"{INDEX_NAME} .*{said}"):
        read_indexes()


NAMES = {"dmd-mnist", "adaptive-mnist"}


def test_small_designs_come_with_the_package(monkeypatch, tmp_path):
    """Made by the package's own list as it is; a collection of one's own comes before them."""
    monkeypatch.delenv("DEEPFSI_DESIGNS", raising=False)
    monkeypatch.chdir(tmp_path)
    designs, recipes = read_indexes()[str(SHIPPED_DESIGNS)], Collection.read().designs
    files = {f"{name}.{kind}" for name in NAMES for kind in ("md", "safetensors")}
    assert designs.keys() == NAMES
    assert {path.name for path in SHIPPED_DESIGNS.iterdir()} == {INDEX_NAME, *files}
    page = (Path(__file__).parents[2] / "docs/notebook/designs.md").read_text()
    for name, entry in designs.items():
        design = load_design(name)
        assert (design.image_shape, len(design.classes)) == ((32, 32), 10)
        assert entry.recipe == recipes[name].hash
        assert entry.photons == design.info["job"]["photons"]
        assert find_design(name).stat().st_size < 9e5
        said = f"{entry.accuracy:.3f} ± {(entry.high - entry.low) / 2:.3f}"
        [row] = [line for line in page.splitlines() if line.startswith(f"| `{name}`")]
        assert said in row


def test_shipped_designs_are_listed_and_a_spoilt_one_is_refused(
    collection, done, monkeypatch, tmp_path
):
    told = json.loads(done("designs", "list", "--json"))
    assert told["where"] == str(collection)
    assert [len(each["designs"]) for each in told["collections"]] == [1, len(NAMES)]
    copy = shutil.copytree(SHIPPED_DESIGNS, tmp_path / "shipped")
    (copy / "dmd-mnist.safetensors").write_bytes(b"spoilt")
    monkeypatch.setattr("deepfsi.designfile.published.SHIPPED_DESIGNS", copy)
    with pytest.raises(InputError, match="wrong sha256"):
        load_design("dmd-mnist")


@real_mnist
def test_shipped_designs_are_as_accurate_as_their_index_says(monkeypatch):
    """On some test images, of one noise draw; within four standard errors."""
    monkeypatch.delenv("DEEPFSI_DESIGNS", raising=False)
    mnist = load_dataset("mnist")
    few = replace(mnist, x_test=mnist.x_test[:200], y_test=mnist.y_test[:200])
    for name, entry in read_indexes()[str(SHIPPED_DESIGNS)].items():
        [result] = evaluate(load_design(name), few, entry.photons, draws=1)
        error = (entry.accuracy * (1 - entry.accuracy) / 200) ** 0.5
        assert abs(result.accuracy - entry.accuracy) < 4 * error
