"""Colours of 16 bits are read whole, whatever file they come in."""

import zlib

import numpy as np
import pytest
import tifffile
from dataset_samples import refused
from PIL import Image

from deepfsi.datasets import load_dataset
from deepfsi.datasets.levels import LUMA

SHAPE = (5, 7)


def png(colours, kind):
    """A PNG file of 16 bits, filtered so that a byte depends on those of its neighbours."""
    height, width, values = colours.shape
    rows = np.ascontiguousarray(colours.astype(">u2")).view(np.uint8).reshape(height, -1)
    left = np.zeros_like(rows)
    left[:, 2 * values :] = rows[:, : -2 * values]
    body = b"".join(b"\1" + row.tobytes() for row in rows - left)  # modulo 256
    head = b"".join(side.to_bytes(4, "big") for side in (width, height)) + bytes(
        [16, kind, 0, 0, 0]
    )
    parts = (b"IHDR", head), (b"IDAT", zlib.compress(body)), (b"IEND", b"")
    chunks = [
        len(content).to_bytes(4, "big")
        + name
        + content
        + zlib.crc32(name + content).to_bytes(4, "big")
        for name, content in parts
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def write_png(path, colours):
    path.with_suffix(".png").write_bytes(png(colours, {2: 4, 3: 2, 4: 6}[colours.shape[2]]))


def write_tiff(path, colours, **options):
    extra = {"extrasamples": ["unassalpha"]} if colours.shape[2] == 4 else {}
    tifffile.imwrite(path.with_suffix(".tif"), colours, photometric="rgb", **extra, **options)


WRITERS = {
    "png": write_png,
    "little-endian": lambda path, colours: write_tiff(path, colours, byteorder="<"),
    "big-endian": lambda path, colours: write_tiff(path, colours, byteorder=">"),
    "compressed": lambda path, colours: write_tiff(path, colours, compression="zlib"),
    "predicted": lambda path, colours: write_tiff(path, colours, compression="zlib", predictor=2),
    "big-endian, compressed": lambda path, colours: write_tiff(
        path, colours, byteorder=">", compression="zlib"
    ),
}


def folder_of(tmp_path, write, channels, highest):
    """Two classes of five images, and their colours in the order of their names."""
    rng = np.random.default_rng(5)
    every = rng.integers(0, highest + 1, (10, *SHAPE, channels), dtype=np.uint16)
    every[0, 0, 0] = highest
    for place, colours in enumerate(every):
        path = tmp_path / "deep" / "ab"[place // 5] / f"{place:02}"
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path, colours)
    return tmp_path / "deep", every


def rows(data):
    """Scenes of both parts, in an order that does not depend on the split."""
    return np.array(sorted(map(tuple, np.r_[data.x_train, data.x_test])))


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("highest", [65535, 4095])
@pytest.mark.parametrize("writer", WRITERS)
def test_colours_of_16_bits_are_read_whole(tmp_path, writer, highest, channels):
    folder, every = folder_of(tmp_path, WRITERS[writer], channels, highest)
    data = load_dataset(folder)
    levels = np.rint(every[..., :3] @ np.array(LUMA)).reshape(10, -1) / highest
    assert rows(data) == pytest.approx(np.array(sorted(map(tuple, levels))), abs=1e-6)
    assert data.white == highest
    bits = {65535: 16, 4095: 12}[highest]
    assert f"divided by {highest} ({bits} bits)" in data.preprocessing


def test_grey_of_16_bits_with_transparency_is_read_whole(tmp_path):
    folder, every = folder_of(tmp_path, write_png, 2, 4095)
    data = load_dataset(folder)
    levels = every[..., 0].reshape(10, -1) / data.white
    assert rows(data) == pytest.approx(np.array(sorted(map(tuple, levels))), abs=1e-6)
    assert "10 with transparency, left out" in data.preprocessing


def test_colours_of_16_and_of_8_bits_are_not_mixed(tmp_path):
    folder, _ = folder_of(tmp_path, write_png, 3, 4095)
    Image.fromarray(np.zeros((*SHAPE, 3), np.uint8)).save(folder / "a" / "00.png")
    with refused("images differ in depth", "save all with one depth"):
        load_dataset(folder)


def test_an_order_that_cannot_be_read_is_refused(tmp_path):
    def planes(path, colours):
        write_tiff(path, np.moveaxis(colours, 2, 0), planarconfig="separate")

    folder, _ = folder_of(tmp_path, planes, 3, 65535)
    with refused("00.tif has colours of more than 8 bits", "side by side"):
        load_dataset(folder)
