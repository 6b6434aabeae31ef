"""Folders of images become scenes; every bad one gives one clear line."""

import shutil
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from dataset_samples import not_loaded
from PIL import Image

from deepfsi.datasets.load import load_dataset
from shared.pictures import save_images


def flat(value, count=1, dtype=np.uint8):
    """Images (n, 6, 8) of one level, as large as those of `images`."""
    return np.full((count, 6, 8), value, dtype)


def every(data):
    return np.r_[data.x_train, data.x_test]


def test_a_path_is_never_a_name(images, monkeypatch):
    monkeypatch.chdir(images.rename(images.with_name("digits")).parent)
    for source in (Path("digits"), "./digits"):
        assert load_dataset(source).image_shape == (6, 8)
    assert load_dataset("digits").image_shape == (8, 8)


def test_image_folder(images):
    data = load_dataset(images)
    assert data.name == "pets"
    assert data.classes == ("cat", "dog")
    assert data.x_train.shape == (16, 48)
    assert data.x_test.shape == (4, 48)
    assert data.image_shape == (6, 8)
    assert data.preprocessing == (
        "20 images of 6x8 pixels; 8-bit values from 0 to 255, divided by 255."
    )
    for x, y in ((data.x_train, data.y_train), (data.x_test, data.y_test)):
        assert np.array_equal(x.mean(axis=1) > 0.5, y == 1)
    first = np.asarray(Image.open(images / "cat" / "000.png"), dtype=np.float32).ravel() / 255
    assert (every(data) == first).all(axis=1).sum() == 1
    assert data.y_train.tolist() != sorted(data.y_train), "shuffled"
    assert load_dataset(str(images), seed=1).hash != data.hash == load_dataset(str(images)).hash


def test_image_folder_with_its_own_split(split):
    data = load_dataset(split)
    assert data.x_train.shape == (20, 48)
    assert data.y_test.tolist() == [0, 1, 1, 1]
    assert data.x_test[:, 0] == pytest.approx([20 / 255] + [200 / 255] * 3)
    assert data.y_train.tolist() != sorted(data.y_train), "shuffled"
    save_images(split / "test" / "eel", flat(20))
    not_loaded(split, "label 'eel'", "'cat', 'dog'")


def deep(images, dtype, suffix, scale=13):
    """The same images in another type, `scale` times as bright."""
    out = images.parent / "deep"
    for folder in images.iterdir():
        levels = [np.asarray(Image.open(path), float) for path in sorted(folder.iterdir())]
        save_images(out / folder.name, [(scale * each).astype(dtype) for each in levels], suffix)
    return out


@pytest.mark.parametrize(
    ("dtype", "scale", "error"), [("u1", 1, 1 / 255), ("u2", 257, 1e-5)]
)  # of 8 bits it would be up to 1 / 510
def test_size_averages_over_areas_in_the_depth_of_the_images(images, dtype, scale, error):
    source = deep(images, dtype, ".png", scale)
    full = np.asarray(Image.open(images / "cat" / "001.png"), dtype=float)
    save_images(source / "cat", np.full((1, 3, 3), 40, dtype))
    data = load_dataset(source, size=(3, 2))
    assert data.image_shape == (3, 2)
    assert data.preprocessing.startswith("20 images averaged to 3x2 pixels; ")
    blocks = full.reshape(3, 2, 2, 4).mean(axis=(1, 3)).ravel() / 255
    assert np.abs(every(data) - blocks).max(axis=1).min() < error
    assert load_dataset(source, size=4).image_shape == (4, 4)


@pytest.mark.parametrize(
    "name",
    [
        "__MACOSX/cat/._000.png", "@eaDir/000.png", ".git/000.png", "$RECYCLE.BIN/a.png",
        "Thumbs.db", ".DS_Store", "README.md", "cat/Thumbs.db", "cat/._000.png", "cat/notes.txt",
    ],
)  # fmt: skip
def test_files_of_systems_and_other_files_are_left_alone(images, name):
    whole = load_dataset(images).hash
    (images / "cat" / "000.png").rename(images / "cat" / "000.PNG")
    (images / name).parent.mkdir(parents=True, exist_ok=True)
    (images / name).write_bytes(b"not an image")
    assert load_dataset(images).hash == whole


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".gif", ".tif", ".bmp", ".webp", ".pgm"])
def test_damaged_images(images, suffix):
    noise = np.random.default_rng(3).integers(0, 256, (1, 64, 64), dtype=np.uint8)
    save_images(images / "dog", noise, suffix)
    path = images / "dog" / f"000{suffix}"
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], whole[:9], b"", b"not an image at all"):
        path.write_bytes(content)
        not_loaded(images, str(path), "cannot read", size=8)


@pytest.mark.parametrize(
    ("dtype", "suffix"), [("u2", ".png"), ("u2", ".tif"), ("i4", ".tif"), (">u2", ".tif")]
)
def test_images_of_more_than_8_bits(images, dtype, suffix):
    source = deep(images, dtype, suffix)
    data = load_dataset(source)
    assert every(data) == pytest.approx(every(load_dataset(images)) * 255 * 13 / 4095, abs=1e-6)
    assert data.white == 4095
    assert "values from 0 to 3315, divided by 4095 (12 bits)." in data.preprocessing
    assert load_dataset(source, white=65535).x_train.max() == pytest.approx(3315 / 65535)
    not_loaded(source, "000", "allowed from 0 to 1023", white=1023)


def test_floating_images_are_reflectance(images):
    source = deep(images, "f4", ".tif", 1 / 255)
    assert load_dataset(source).x_train == pytest.approx(load_dataset(images).x_train, abs=1e-6)
    save_images(source / "cat", flat(2.5, dtype="f4"), ".tif")
    not_loaded(source, "to 2.5", "rescale")


@pytest.mark.parametrize("suffix", [".jfif", ".ppm", ".heic"])
def test_no_image_of_another_ending_is_lost_in_silence(images, suffix):
    path = images / "cat" / "001.png"
    if suffix == ".heic":
        path.rename(path.with_suffix(suffix)).write_bytes(b"\0\0\0\x18ftypheic")
        not_loaded(images, "001.heic (no image of a kind that is read)")
    else:
        picture = Image.open(path)
        path.unlink()
        picture.save(path.with_suffix(suffix), {".jfif": "JPEG", ".ppm": "PPM"}[suffix])
        assert len(every(load_dataset(images))) == 20


def test_images_that_need_too_much_memory(images, monkeypatch):
    monkeypatch.setattr("deepfsi.base.arrays.free_memory", lambda: 9 * 20 * 48 - 1)
    not_loaded(images, "20 images of 6x8 pixels need", "smaller size")
    monkeypatch.setattr("deepfsi.base.arrays.free_memory", lambda: 9 * 20 * 48)
    load_dataset(images)


def test_some_training_images(split):
    whole = load_dataset(split)
    data = load_dataset(split, images=6)
    assert np.bincount(data.y_train).tolist() == [3, 3]
    assert np.array_equal(data.x_test, whole.x_test)
    assert set(map(bytes, data.x_train)) <= set(map(bytes, whole.x_train))
    assert data.preprocessing.startswith("6 training images drawn by class; 10 images of 6x8")
    assert data.hash == load_dataset(split, images=6).hash
    assert data.hash != load_dataset(split, images=6, seed=1).hash
    assert load_dataset(split, images=20).hash == whole.hash
    for count in (0, 1, 21, -4):
        not_loaded(split, f"{count} of 20 training images", "2 (one of each class)", images=count)


def beside(name):
    """Copy an image to a path below the folder."""

    def copy(folder):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(folder / "cat" / "001.png", folder / name)

    return copy


def as_it_is(folder): ...


BAD_FOLDERS = {
    "no class": (lambda f: list(map(shutil.rmtree, f.iterdir())), {}, ("needs a sub-folder",)),
    "a class of none": (lambda f: (f / "eel").mkdir(), {}, ("eel has none",)),
    "a class of few": (
        lambda f: save_images(f / "eel", flat(20, 2)), {}, ("class 'eel' has 2 scenes",)
    ),
    "an image beside": (beside("000.png"), {}, ("in no folder of a class", "000.png)", "move")),
    "an image below": (
        beside("cat/night/000.JPG"), {}, ("in no folder of a class", "cat/night/000.JPG)")
    ),
    "sizes": (
        lambda f: save_images(f / "cat", np.full((1, 3, 3), 40, np.uint8)), {},
        ("others are 3x3", "001.png is 6x8", "size"),
    ),
    "depths": (
        lambda f: save_images(f / "cat", flat(900, dtype="u2"), ".tif"), {},
        ("png uint8 and ", "000.tif uint16: give one type"),
    ),
    "a format that is not read": (
        lambda f: Image.new("L", (8, 6)).save(f / "cat" / "000.png", format="ICO"), {},
        ("cat/000.png", "no image"),
    ),
    "a number of images": (
        as_it_is, {"images": 10}, ("10 training images", "own train and test folders")
    ),
    "a split": (as_it_is, {"split": "blocks"}, ("takes no `split`",)),
    "a size": (as_it_is, {"size": (4, 0)}, ("size",)),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_FOLDERS)
def test_a_bad_folder_is_refused(images, case):
    change, options, parts = BAD_FOLDERS[case]
    change(images)
    not_loaded(images, *parts, **options)


def test_parts_may_have_capitals_and_others_are_named(split):
    whole = load_dataset(split)
    (split / "train").rename(split / "Train")
    (split / "test").rename(split / "Test")
    assert load_dataset(split).hash == whole.hash
    (split / "notes").mkdir()
    assert load_dataset(split).hash == whole.hash
    shutil.copytree(split / "Test", split / "val")
    not_loaded(split, "in no folder of a class", "val/")


ACUTE = "caf\u00e9"


def test_a_class_in_two_unicode_spellings_is_one(images):
    other = images / unicodedata.normalize("NFD", ACUTE)
    (images / "cat").rename(other)
    one = load_dataset(images)
    (images / ACUTE).mkdir()
    for path in sorted(other.iterdir())[:5]:
        path.rename(images / ACUTE / path.name)
    data = load_dataset(images)
    assert set(data.classes) == {ACUTE, "dog"}
    assert data.hash == one.hash
