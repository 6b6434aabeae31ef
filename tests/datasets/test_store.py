"""Files come from `$DEEPFSI_DATA`, the cache or a mirror, whole or not at all."""

import gzip
import hashlib
import http.server
import threading

import numpy as np
import pooch
import pytest
from dataset_samples import not_loaded

from deepfsi.datasets import catalog
from deepfsi.datasets.load import load_dataset

IMAGES = np.random.default_rng(4).integers(0, 256, (24, 28, 28), dtype=np.uint8)
LABELS = np.arange(24) % 10


def idx_file(array):
    header = bytes([0, 0, 8, array.ndim]) + np.array(array.shape, ">u4").tobytes()
    return gzip.compress(header + array.astype(np.uint8).tobytes(), mtime=0)


FILES = list(catalog.DATASETS["mnist"].hashes)
PARTS = (IMAGES[:20], LABELS[:20], IMAGES[20:], LABELS[20:])
TINY = dict(zip(FILES, map(idx_file, PARTS), strict=True))


def fill(folder, **spoilt):
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in (TINY | spoilt).items():
        (folder / file).write_bytes(content)


@pytest.fixture
def server(tmp_path, monkeypatch):
    """A tiny MNIST with two mirrors below `tmp_path`, whose requests are kept; none is filled."""
    (tmp_path / "first").mkdir()
    (tmp_path / "second").mkdir()

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args):
            super().__init__(*args, directory=str(tmp_path))

        def log_request(self, *_):
            self.server.requests.append(self.path)

        def log_message(self, *_): ...

    serving = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    serving.requests = []
    threading.Thread(target=serving.serve_forever, args=(0.01,), daemon=True).start()
    address = f"http://127.0.0.1:{serving.server_port}"
    mnist = catalog.DATASETS["mnist"]
    sums = {file: f"sha256:{hashlib.sha256(each).hexdigest()}" for file, each in TINY.items()}
    monkeypatch.setattr(mnist, "hashes", sums)
    monkeypatch.setattr(mnist, "mirrors", (f"{address}/first/", f"{address}/second/"))
    monkeypatch.setattr(pooch, "os_cache", lambda _: tmp_path / "cache")
    monkeypatch.delenv("DEEPFSI_DATA", raising=False)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    yield serving
    serving.shutdown()
    serving.server_close()


def assert_tiny(data):
    assert data.image_shape == (32, 32)
    assert data.classes == tuple("0123456789")
    framed = np.zeros((24, 32, 32))
    framed[:, 2:-2, 2:-2] = IMAGES / 255
    expected = (0.3 + 0.7 * framed).reshape(24, 1024)
    assert np.allclose(data.x_train, expected[:20], atol=1e-6), "in the order of the files"
    assert np.allclose(data.x_test, expected[20:], atol=1e-6)
    assert data.x_train.dtype == np.float32
    assert data.y_train.dtype == np.int64
    assert np.array_equal(np.r_[data.y_train, data.y_test], LABELS)
    assert data.x_train.min() == np.float32(0.3)


def test_files_are_downloaded_once(server, tmp_path):
    fill(tmp_path / "first")
    assert_tiny(load_dataset("mnist"))
    assert server.requests == [f"/first/{file}" for file in TINY]
    assert_tiny(load_dataset("mnist"))
    assert len(server.requests) == 4


def test_the_next_mirror_is_tried(server, tmp_path):
    fill(tmp_path / "second")
    fill(tmp_path / "first", **{FILES[0]: b"damaged on the way"})
    (tmp_path / "first" / FILES[1]).unlink()
    assert_tiny(load_dataset("mnist"))
    asked = [path.split("/")[1] for path in server.requests]
    assert asked == ["first", "second", "first", "second", "first", "first"]


def test_no_mirror_gives_a_file(server, tmp_path):
    fill(tmp_path / "first", **{FILES[2]: b"damaged"})
    host = f"127.0.0.1:{server.server_port}"
    said = f"{FILES[2]} from {host} or {host}"
    not_loaded("mnist", "mnist: cannot download", said, "set DEEPFSI_DATA")
    kept = sorted(path.name for path in (tmp_path / "cache" / "mnist").iterdir())
    assert kept == sorted(FILES[:2]), "nothing half-written"


def test_deepfsi_data_comes_first_and_needs_the_folder(server, tmp_path, monkeypatch):
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path / "mine"))
    fill(tmp_path / "mine")
    not_loaded("mnist", "cannot download")
    assert server.requests, "files directly in DEEPFSI_DATA are not used"
    server.requests.clear()
    fill(tmp_path / "mine" / "mnist")
    assert_tiny(load_dataset("mnist"))
    assert not server.requests


def test_a_damaged_file_in_deepfsi_data_is_refused_and_stays(server, tmp_path, monkeypatch):
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    fill(tmp_path / "first")
    damaged = idx_file(LABELS[1:21])
    fill(tmp_path / "mnist", **{FILES[1]: damaged})
    not_loaded("mnist", f"{FILES[1]} is damaged")
    assert (tmp_path / "mnist" / FILES[1]).read_bytes() == damaged
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path / "mistyped"))
    not_loaded("mnist", "DEEPFSI_DATA", "mistyped", "no folder")
