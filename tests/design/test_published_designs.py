"""Published designs are opened by name, from a folder or an address, as their index says."""

import functools
import hashlib
import http.server
import json
import threading

import pooch
import pytest

from deepfsi.design.adaptive.design import load_design
from deepfsi.design.published import INDEX, VARIABLE, Index, Published, find_design, read_index
from deepfsi.errors import InputError


@pytest.fixture
def collection(made, tmp_path, monkeypatch):
    """Folder with one design, `small`; nothing is cached, and nothing is in the way of its name."""
    folder = tmp_path / "collection"
    content = made("pca", "column", "dual").to_bytes()
    folder.mkdir()
    (folder / "small.safetensors").write_bytes(content)
    index(folder, hashlib.sha256(content).hexdigest())
    monkeypatch.setattr(pooch, "os_cache", lambda _: tmp_path / "cache")
    monkeypatch.setenv(VARIABLE, str(folder))
    monkeypatch.chdir(tmp_path)
    return folder


def index(folder, sha256):
    numbers = {"photons": 1e4, "accuracy": 0.5, "low": 0.4, "high": 0.6}
    entry = Published(sha256=sha256, recognises="it", data="it", recipe="0" * 64, **numbers)
    (folder / INDEX).write_text(Index(designs={"small": entry}).model_dump_json())


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
        monkeypatch.setenv(VARIABLE, f"http://127.0.0.1:{server.server_port}/")
        yield asked
        server.shutdown()


def test_a_name_is_looked_for_in_the_folder(collection, monkeypatch):
    assert load_design("small").masks == load_design(collection / "small.safetensors").masks
    monkeypatch.setenv(VARIABLE, collection.as_uri())
    assert find_design("small") == collection / "small.safetensors"


def test_what_is_there_comes_before_a_published_name(collection, tmp_path):
    (tmp_path / "small").mkdir()
    assert str(find_design("small")) == "small"
    assert str(find_design("small.safetensors")) == "small.safetensors"


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
    monkeypatch.setenv(VARIABLE, str(collection))
    with pytest.raises(InputError, match=r"wrong sha256.*make it again"):
        load_design("small")


@pytest.mark.parametrize(
    ("where", "words"),
    [
        (None, f"no design file at smal: make one with .*set {VARIABLE} to the folder or address"),
        ("collection", "no published design 'smal' .*did you mean 'small'"),
        ("nowhere", f"nowhere/{INDEX} is missing: give the folder of a collection"),
        ("ftp://a.example", "give a folder, or an address of http, https or file"),
        ("http://127.0.0.1:9", f"cannot download http://127.0.0.1:9/{INDEX} .ConnectionError"),
    ],
)
def test_what_cannot_be_found_is_said_in_one_line(collection, monkeypatch, where, words):
    monkeypatch.delenv(VARIABLE) if where is None else monkeypatch.setenv(VARIABLE, where)
    with pytest.raises(InputError, match=words):
        load_design("smal")


@pytest.mark.parametrize("spoilt", ["{", '{"schema_version": 2}', '{"designs": {"../a": {}}}'])
def test_a_spoilt_index_is_refused(collection, spoilt):
    (collection / INDEX).write_text(spoilt)
    with pytest.raises(InputError, match=f"{INDEX} cannot be used.*make the collection again"):
        read_index()


def test_commands_take_a_name(collection, done, refuse, tmp_path):
    assert "small" in done("designs", "list")
    words = ("small", "--data", "digits", "--photons", "1e4", "--draws", "1", "--json")
    assert json.loads(done("evaluate", *words))["results"]
    assert "did you mean 'small'" in refuse("page", "smal", "-o", tmp_path / "page.html")
