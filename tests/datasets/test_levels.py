"""What the header of an image says of its values is followed, or refused in one line."""

import numpy as np
import pytest
import tifffile
from dataset_samples import refused
from PIL import Image

from deepfsi.datasets.display import read_display

GREY = (np.arange(48).reshape(6, 8) * 5).astype(np.uint8)
UPRIGHT = {1: GREY, 3: GREY[::-1, ::-1], 6: np.rot90(GREY, -1), 8: np.rot90(GREY), 4: GREY[::-1]}


@pytest.mark.parametrize("orientation", UPRIGHT)
@pytest.mark.parametrize("suffix", ["png", "tif", "webp"])
def test_pictures_stand_as_every_viewer_shows_them(tmp_path, orientation, suffix):
    """Cameras write the sensor's order, and in EXIF how to turn it."""
    exif = Image.Exif()
    exif[274] = orientation
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(GREY).save(path, exif=exif, **{"lossless": True} if suffix == "webp" else {})
    shown = read_display(path)
    assert np.rint(shown.x[0] * 255).astype(int).tolist() == UPRIGHT[orientation].tolist()


@pytest.mark.parametrize(
    ("values", "said"),
    [(np.ones((2, 3)), "floats of 16 or 64 bits"), (np.full((2, 3), -5, np.int16), "from -5")],
)
def test_types_that_are_not_read_are_refused(tmp_path, values, said):
    tifffile.imwrite(tmp_path / "a.tif", values)
    with refused("a.tif", said):
        read_display(tmp_path / "a.tif")


@pytest.mark.parametrize("largest", [15, 200, 255, 1023])
def test_the_largest_value_of_a_pgm_is_white(tmp_path, largest):
    rows = f"0 {largest}\n{largest // 3} 1\n"
    (tmp_path / "a.pgm").write_text(f"P2\n2 2\n{largest}\n{rows}")
    shown = read_display(tmp_path / "a.pgm").x[0]
    assert shown[:, 0] == pytest.approx([0, largest // 3 / largest], abs=1 / 255)
    assert shown[0, 1] == pytest.approx(1)


def test_deep_grey_levels_whose_zero_is_white_are_refused(tmp_path):
    """Pillow turns them over in 8 bits alone."""
    Image.fromarray(np.full((5, 7), 40_000, np.uint16)).save(tmp_path / "a.tif", tiffinfo={262: 0})
    with refused("a.tif has 0 for white"):
        read_display(tmp_path / "a.tif")


@pytest.mark.parametrize("mode", ["P", "1", "LA", "RGB", "RGBA", "CMYK", "YCbCr"])
def test_modes_have_the_grey_of_their_colours(tmp_path, mode):
    picture = Image.fromarray(GREY).convert("RGB").convert(mode)
    path = tmp_path / ("a.tif" if mode in ("CMYK", "YCbCr") else "a.png")
    picture.save(path)
    wanted = np.asarray(picture.convert("RGB").convert("L"), float) / 255
    assert read_display(path).x[0] == pytest.approx(wanted, abs=2 / 255)
