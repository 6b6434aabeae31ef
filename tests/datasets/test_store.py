"""Files come from `$DEEPFSI_DATA`, the cache or a mirror, whole or not at all."""

import hashlib
import http.server
import threading
from contextlib import contextmanager

import numpy as np
import pooch
import pytest
from dataset_samples import TINY, TINY_IMAGES, TINY_LABELS, idx_file, refused

from deepfsi.base import InputError, Progress
from deepfsi.datasets import check, download, list_datasets, load_dataset, store
from deepfsi.datasets.catalog import DATASETS

FILES = list(TINY)


class Mirrors:
    """Two folders served on this machine as the mirrors of a tiny MNIST; counts the requests."""

    def __init__(self, folder):
        self.first, self.second = folder / "first", folder / "second"
        self.first.mkdir()
        self.second.mkdir()
        self.requests: list[str] = []
        requests = self.requests

        class Handler(http.server.SimpleHTTPRequestHandler):
            def __init__(self, *args):
                super().__init__(*args, directory=str(folder))

            def log_request(self, *_):
                requests.append(self.path)

            def log_message(self, *_): ...

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.urls = tuple(
            f"http://127.0.0.1:{self.server.server_port}/{mirror}/"
            for mirror in ("first", "second")
        )
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()


def fill(folder, **spoilt):
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in (TINY | spoilt).items():
        (folder / file).write_bytes(content)


@pytest.fixture
def mirrors(tmp_path, monkeypatch):
    """A tiny MNIST with empty mirrors and an empty cache, `tmp_path / "cache"`."""
    (tmp_path / "served").mkdir()
    served = Mirrors(tmp_path / "served")
    hashes = {
        name: f"sha256:{hashlib.sha256(content).hexdigest()}" for name, content in TINY.items()
    }
    monkeypatch.setattr(DATASETS["mnist"], "hashes", hashes)
    monkeypatch.setattr(DATASETS["mnist"], "mirrors", served.urls)
    monkeypatch.setattr(pooch, "os_cache", lambda _: tmp_path / "cache")
    monkeypatch.delenv("DEEPFSI_DATA", raising=False)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    yield served
    served.server.shutdown()
    served.server.server_close()


def assert_tiny(data):
    assert data.image_shape == (32, 32)
    assert data.classes == tuple("0123456789")
    framed = np.zeros((24, 32, 32))
    framed[:, 2:-2, 2:-2] = TINY_IMAGES / 255
    expected = (0.3 + 0.7 * framed).reshape(24, 1024)
    assert np.allclose(data.x_train, expected[:20], atol=1e-6), "in the order of the files"
    assert np.allclose(data.x_test, expected[20:], atol=1e-6)
    assert data.x_train.dtype == np.float32
    assert data.y_train.dtype == np.int64
    assert np.array_equal(np.r_[data.y_train, data.y_test], TINY_LABELS)
    assert data.x_train.max() <= 1
    assert data.x_train.min() == np.float32(0.3)


def test_files_are_downloaded_once(mirrors, tmp_path, caplog, monkeypatch):
    monkeypatch.setattr(pooch.get_logger(), "handlers", [caplog.handler])
    fill(mirrors.first)
    assert_tiny(load_dataset("mnist"))
    assert mirrors.requests == [f"/first/{file}" for file in TINY]
    assert_tiny(load_dataset("mnist"))
    assert len(mirrors.requests) == 4
    assert download("mnist") == tmp_path / "cache" / "mnist"
    assert not caplog.records


def test_the_next_mirror_is_tried(mirrors):
    fill(mirrors.second)
    fill(mirrors.first, **{FILES[0]: b"damaged on the way"})
    (mirrors.first / FILES[1]).unlink()
    assert_tiny(load_dataset("mnist"))
    assert [path.split("/")[1] for path in mirrors.requests] == [
        *("first", "second"),
        *("first", "second"),
        *("first", "first"),
    ]


def test_no_mirror_gives_a_file(mirrors, tmp_path):
    fill(mirrors.first, **{FILES[2]: b"damaged"})
    host = f"127.0.0.1:{mirrors.server.server_port}"
    with refused(
        f"mnist: cannot download {FILES[2]}",
        f"{host} (wrong hash) or {host} (HTTPError)",
        "set DEEPFSI_DATA",
    ):
        load_dataset("mnist")
    kept = sorted(path.name for path in (tmp_path / "cache" / "mnist").iterdir())
    assert kept == sorted(FILES[:2]), "nothing half-written"


def test_no_connection(mirrors):
    mirrors.server.shutdown()
    mirrors.server.server_close()
    with refused("mnist", "127.0.0.1", "(ConnectionError)", "set DEEPFSI_DATA"):
        download("mnist")


def test_a_damaged_file_in_the_cache_is_downloaded_again(mirrors, tmp_path):
    fill(mirrors.first)
    fill(tmp_path / "cache" / "mnist", **{FILES[3]: b"damaged"})
    assert_tiny(load_dataset("mnist"))
    assert mirrors.requests == [f"/first/{FILES[3]}"]


def test_deepfsi_data_comes_first_and_needs_the_folder(mirrors, tmp_path, monkeypatch):
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path / "mine"))
    fill(tmp_path / "mine")
    with pytest.raises(InputError):
        load_dataset("mnist")
    assert mirrors.requests, "files directly in DEEPFSI_DATA are not used"
    mirrors.requests.clear()
    fill(tmp_path / "mine" / "mnist")
    assert_tiny(load_dataset("mnist"))
    assert download("mnist") == tmp_path / "mine" / "mnist"
    assert not mirrors.requests


def test_a_damaged_file_in_deepfsi_data(mirrors, tmp_path, monkeypatch):
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    fill(tmp_path / "mnist", **{FILES[1]: idx_file(TINY_LABELS[1:21])})
    with refused(str(tmp_path / "mnist" / FILES[1]), "sha256", "original"):
        load_dataset("mnist")
    assert [result.ok for result in check("mnist")] == [True, False, True, True]


def test_deepfsi_data_that_is_no_folder(mirrors, tmp_path, monkeypatch):
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path / "mistyped"))
    with refused("DEEPFSI_DATA", "mistyped", "no folder"):
        load_dataset("mnist")


def test_check_and_list(mirrors, tmp_path, monkeypatch):
    monkeypatch.setattr(DATASETS["indian-pines"], "PACKAGE", ("no_such_package", "data"))
    where = {info.name: info.where for info in list_datasets()}
    assert where.pop("digits") == "embedded"
    assert len(where) == 5
    assert set(where.values()) == {"not here"}
    assert [(result.file, result.ok) for result in check("mnist")] == [
        (file, False) for file in FILES
    ]
    assert "No such file" in check("mnist")[0].detail
    assert check("digits")[0].ok

    fill(tmp_path / "cache" / "mnist")
    assert list_datasets()[1].where == str(tmp_path / "cache" / "mnist")
    assert all(result.ok for result in check("mnist"))
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    fill(tmp_path / "mnist")
    assert list_datasets()[1].where == str(tmp_path / "mnist")
    assert not mirrors.requests


def test_a_download_says_how_far_it_is(monkeypatch):
    shares = []

    @contextmanager
    def bar(what):
        yield Progress(lambda share, _: shares.append((what, share)))

    def retrieve(*_, progressbar):
        progressbar.update(10)  # before the size is known
        progressbar.total = 40
        progressbar.update(10)
        progressbar.reset()
        progressbar.update(40)
        progressbar.close()

    monkeypatch.setattr(store, "terminal_bar", bar)
    monkeypatch.setattr(pooch, "retrieve", retrieve)
    store.download_files("mnist", {"images.gz": "sha256:0"}, ("http://here/",))
    assert shares == [("images.gz", share) for share in (0, 0.5, 1)]


def test_fewer_training_images_keep_the_classes_shares_and_the_test_part(mirrors):
    fill(mirrors.first)
    whole, few = load_dataset("mnist"), load_dataset("mnist", images=10)
    assert np.bincount(few.y_train).tolist() == [1] * 10
    assert np.array_equal(few.x_test, whole.x_test)
    place = [int(np.flatnonzero((whole.x_train == scene).all(axis=1))[0]) for scene in few.x_train]
    assert place == sorted(place), "in the order of the file"
    assert "10 training images drawn by class" in few.preprocessing
    other = load_dataset("mnist", images=10, seed=1)
    assert not np.array_equal(other.x_train, few.x_train)
    assert few.origin.images == 10
    with refused("21 of 20 training images were asked for", "give 10"):
        load_dataset("mnist", images=21)


def test_an_array_that_cannot_be_kept_is_made_again(tmp_path):
    """A cache that cannot be written, and an array that is not the expected one."""
    made = []

    def make():
        made.append(1)
        return np.arange(6.0)

    (tmp_path / "file").write_text("in the way of a folder")
    expected = store.hash_array(np.arange(6.0))
    for path, digest in ((tmp_path / "file" / "a.npy", expected), (tmp_path / "b.npy", "other")):
        for _ in range(2):
            assert np.array_equal(store.kept_array(path, digest, make), np.arange(6.0))
    assert len(made) == 4
    assert not (tmp_path / "b.npy").exists()
    assert store.hash_array(np.arange(6.0)) != store.hash_array(np.arange(6.0).reshape(2, 3))
