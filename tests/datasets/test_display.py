"""Scenes are written as pictures for a display, and pictures read back."""

import os
from dataclasses import replace

import numpy as np
import pytest

from deepfsi import InputError
from deepfsi.datasets.display import read_display, write_display
from deepfsi.datasets.load import load_dataset
from shared.pictures import save_images


def test_scenes_are_written_and_read_back(digits, tmp_path):
    write_display(digits, tmp_path / "images", per_class=2, seed=3)
    shown = read_display(tmp_path / "images")
    assert shown.labels == tuple(c for c in digits.classes for _ in range(2))
    assert shown.x.shape == (20, 8, 8)
    places = [int(name.split("/")[1].removesuffix(".png")) for name in shown.names]
    truth = digits.x_test[places].reshape(-1, 8, 8)
    assert np.abs(shown.x - truth).max() <= 0.5 / 255 + 1e-6
    assert [digits.classes[k] for k in digits.y_test[places]] == list(shown.labels)
    again = write_display(digits, tmp_path / "again", per_class=2, seed=3)
    assert [path.name for path in again] == [name.split("/")[1] for name in shown.names]
    with pytest.raises(InputError, match="new folder"):
        write_display(digits, tmp_path / "again", per_class=1)


@pytest.mark.parametrize("label", ["../out", "/out", "T-shirt/top", ".hidden", ".."])
def test_classes_that_are_no_folders_are_refused(digits, tmp_path, label):
    named = replace(digits, classes=(label, *digits.classes[1:]))
    with pytest.raises(InputError, match="cannot be a folder"):
        write_display(named, tmp_path / "images", per_class=1)
    assert not list(tmp_path.iterdir())


def test_one_picture_or_a_plain_folder_is_read(tmp_path):
    save_images(tmp_path, [np.full((4, 6), level, np.uint8) for level in (0, 51)])
    shown = read_display(tmp_path)
    assert shown.names == ("000.png", "001.png")
    assert shown.labels is None
    assert shown.x[1, 0, 0] == pytest.approx(0.2)
    assert read_display(tmp_path / "001.png").x.shape == (1, 4, 6)
    with pytest.raises(InputError, match="no picture"):
        read_display(tmp_path / "002.png")


def test_names_that_are_not_utf_8_are_told_as_text(tmp_path):
    """Of pictures, of the folders of classes; a path that a design would keep is refused."""
    odd = os.fsdecode(b"c\xff")
    for label in (odd, "b"):
        save_images(tmp_path / label, np.eye(6, dtype=np.uint8)[:, None], f"{odd}.png")
    assert read_display(tmp_path).names[-1] == r"c\xff/005c\xff.png"
    assert load_dataset(tmp_path).classes == ("b", r"c\xff")
    with pytest.raises(InputError, match=r"c\\xff is not UTF-8: rename the file or folder"):
        load_dataset(tmp_path / odd)
