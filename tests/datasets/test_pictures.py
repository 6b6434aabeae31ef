"""Folders, zip files and lists of images become scenes; every bad one gives one clear line."""

import shutil
import subprocess
import sys
import unicodedata
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from dataset_samples import refused
from PIL import Image

from deepfsi.datasets import load_dataset, pictures, read_display
from shared.pictures import save_images


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
    assert (np.r_[data.x_train, data.x_test] == first).all(axis=1).sum() == 1
    assert data.y_train.tolist() != sorted(data.y_train), "shuffled"
    assert load_dataset(str(images), seed=1).hash != data.hash == load_dataset(str(images)).hash


def test_image_folder_with_its_own_split(split):
    data = load_dataset(split)
    assert data.x_train.shape == (20, 48)
    assert data.y_test.tolist() == [0, 1, 1, 1]
    assert data.x_test[:, 0] == pytest.approx([20 / 255] + [200 / 255] * 3)
    assert data.y_train.tolist() != sorted(data.y_train), "shuffled"

    save_images(split / "test" / "eel", np.full((1, 6, 8), 20, np.uint8))
    with refused("label 'eel'", "'cat', 'dog'"):
        load_dataset(split)


def test_size_averages_over_areas(images):
    save_images(images / "cat", np.full((1, 3, 3), 40, np.uint8))
    with refused("000.png is 3x3", "001.png is 6x8", "size"):
        load_dataset(images)
    data = load_dataset(images, size=(3, 2))
    assert data.image_shape == (3, 2)
    assert data.preprocessing == (
        "20 images of several sizes, averaged to 3x2 pixels; 8-bit values from 0 to 255, divided "
        "by 255."
    )
    full = np.asarray(Image.open(images / "cat" / "001.png"), dtype=float)
    blocks = full.reshape(3, 2, 2, 4).mean(axis=(1, 3)).ravel() / 255
    distance = np.abs(np.r_[data.x_train, data.x_test] - blocks).max(axis=1)
    assert distance.min() < 1 / 255
    assert load_dataset(images, size=4).image_shape == (4, 4)


@pytest.mark.parametrize("size", [0, -3, (4, 0), (4,), (4, 4, 4)])
def test_bad_size(images, size):
    with refused(f"size {size}", "at least 1"):
        load_dataset(images, size=size)


def test_colours_turn_grey(images):
    green = np.zeros((1, 6, 8, 3), np.uint8)
    green[..., 1] = 255
    save_images(images / "cat", green)
    data = load_dataset(images)
    flat = np.ptp(np.r_[data.x_train, data.x_test], axis=1) == 0
    assert np.r_[data.x_train, data.x_test][flat][:, 0] == pytest.approx([150 / 255])


def test_other_files_are_left_alone(images):
    before = load_dataset(images).hash
    (images / "cat" / "notes.txt").write_text("not an image")
    (images / "cat" / "._000.png").write_text("what a Mac leaves on a stick")
    (images / "README.md").write_text("pets")
    (images / ".cache").mkdir()
    assert load_dataset(images).hash == before
    (images / "cat" / "000.png").rename(images / "cat" / "000.PNG")
    assert load_dataset(images).hash == before


def test_empty_folder(tmp_path):
    with refused(str(tmp_path), "no sub-folders", ".csv file of file names and labels"):
        load_dataset(tmp_path)


def test_class_folder_without_images(images):
    (images / "eel").mkdir()
    (images / "eel" / "notes.txt").write_text("none yet")
    with refused(str(images / "eel"), "no images"):
        load_dataset(images)


def test_folder_with_one_class(images):
    for path in (images / "dog").iterdir():
        path.unlink()
    (images / "dog").rmdir()
    with refused("only one class, cat"):
        load_dataset(images)


def test_class_with_few_images(images):
    save_images(images / "eel", np.full((2, 6, 8), 20, np.uint8))
    with refused("class 'eel' has 2 scenes"):
        load_dataset(images)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".gif", ".tif", ".bmp", ".webp", ".pgm"])
def test_damaged_images(images, suffix):
    noise = np.random.default_rng(3).integers(0, 256, (1, 64, 64), dtype=np.uint8)
    save_images(images / "dog", noise, suffix)
    path = images / "dog" / f"000{suffix}"
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], whole[:9], b"", b"not an image at all"):
        path.write_bytes(content)
        with refused(str(path), "cannot read"):
            load_dataset(images, size=8)


def deep(images, dtype, suffix, scale=13):
    """The same images in another type, `scale` times as bright."""
    out = images.parent / "deep"
    for folder in images.iterdir():
        levels = [np.asarray(Image.open(path)) for path in sorted(folder.iterdir())]
        save_images(
            out / folder.name,
            [(scale * each.astype(float)).astype(dtype) for each in levels],
            suffix,
        )
    return out


@pytest.mark.parametrize(
    ("dtype", "suffix"), [("u2", ".png"), ("u2", ".tif"), ("i4", ".tif"), (">u2", ".tif")]
)
def test_images_of_more_than_8_bits(images, dtype, suffix):
    data = load_dataset(deep(images, dtype, suffix))
    plain = load_dataset(images)
    for x, bright in ((plain.x_train, data.x_train), (plain.x_test, data.x_test)):
        assert bright == pytest.approx(x * 255 * 13 / 4095, abs=1e-6)
    assert data.white == 4095
    assert data.preprocessing == (
        "20 images of 6x8 pixels; 16-bit values from 0 to 3315, divided by 4095 (12 bits)."
    )
    told = load_dataset(images.parent / "deep", white=65535)
    assert told.x_train.max() == pytest.approx(3315 / 65535)
    with refused("000", "above white, 1023"):
        load_dataset(images.parent / "deep", white=1023)


def test_deep_images_are_averaged_in_their_own_depth(images):
    data = load_dataset(deep(images, "u2", ".png", 257), size=(3, 2))
    full = np.asarray(Image.open(images / "cat" / "001.png"), dtype=float)
    blocks = full.reshape(3, 2, 2, 4).mean(axis=(1, 3)).ravel() / 255
    distance = np.abs(np.r_[data.x_train, data.x_test] - blocks).max(axis=1)
    assert distance.min() < 1e-5, "of 8 bits it would be up to 1 / 510"


def test_floating_images_are_reflectance(images):
    data = load_dataset(deep(images, "f4", ".tif", 1 / 255))
    assert data.x_train == pytest.approx(load_dataset(images).x_train, abs=1e-6)
    save_images(images.parent / "deep" / "cat", np.full((1, 6, 8), 2.5, "f4"), ".tif")
    with refused("to 2.5", "rescale"):
        load_dataset(images.parent / "deep")


def test_depths_that_differ_are_refused(images):
    save_images(images / "cat", np.full((1, 6, 8), 900, "u2"), ".tif")
    with refused("images differ in depth", "000.tif has more than 8 bits", "one depth"):
        load_dataset(images)


def test_a_tiff_whose_zero_is_white_is_refused(images):
    path = images / "cat" / "000.tif"
    save_images(images / "cat", np.full((1, 6, 8), 900, "u2"), ".tif")
    with Image.open(path) as image:
        image.load()
        image.save(path, tiffinfo={262: 0})
    with refused("000.tif has 0 for white"):
        load_dataset(path.parent.parent)


def test_what_was_done_to_images_is_said(images):
    green = np.zeros((2, 6, 8, 3), np.uint8)
    green[..., 1] = 200
    save_images(images / "cat", green[:1])
    Image.fromarray(np.full((6, 8, 4), 90, np.uint8)).save(images / "cat" / "001.png")
    pages = [Image.fromarray(np.full((6, 8), 9, np.uint8)) for _ in range(3)]
    pages[0].save(images / "dog" / "001.tif", save_all=True, append_images=pages[1:])
    said = load_dataset(images).preprocessing
    for part in (
        "21 images of 6x8 pixels",
        "2 in colour, turned to grey",
        "1 with transparency, left out",
        "1 the first of several in a file",
    ):
        assert part in said


def test_all_damaged_images_are_named_at_once(images):
    bad = [images / "cat" / "003.png", images / "dog" / "001.png", images / "dog" / "002.png"]
    for path, content in zip(bad, (b"", b"no image", bad[2].read_bytes()[:60]), strict=True):
        path.write_bytes(content)
    with refused("cannot read 3 images: ", *map(str, bad), "leave them out with `skip_bad`"):
        load_dataset(images)
    data = load_dataset(images, skip_bad=True)
    assert "3 that cannot be read left out (cat/003.png, dog/001.png, dog/002.png)" in (
        data.preprocessing
    )
    assert data.origin.skip_bad
    assert len(data.x_train) + len(data.x_test) == 17
    for path in bad:
        path.unlink()
    assert data.hash == load_dataset(images).hash, "as if they were not there"


def test_damaged_images_of_a_training_part_do_not_move_the_test_part(split):
    whole = load_dataset(split)
    for place in range(3):
        (split / "train" / "cat" / f"00{place}.png").write_bytes(b"")
    data = load_dataset(split, skip_bad=True)
    assert len(data.x_train) == 17
    assert np.array_equal(data.x_test, whole.x_test)
    assert np.array_equal(data.y_test, whole.y_test)


def test_images_that_are_all_damaged_are_never_left_out(images):
    for path in images.rglob("*.png"):
        path.write_bytes(b"")
    with refused("cannot read 20 images", "001.png"):
        load_dataset(images, skip_bad=True)
    for place in range(30):
        (images / "cat" / f"1{place:02}.png").write_bytes(b"")
    with refused("cannot read 50 images", "and 30 more"):
        load_dataset(images)


def test_a_bomb_among_images(images, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    for side, part in ((11, "decompression bomb"), (30, "decompression bomb")):
        save_images(images / "dog", np.full((1, side, side), 9, np.uint8))
        with refused("dog/000.png", "cannot read", part):
            load_dataset(images, size=2)


def test_images_that_need_too_much_memory(images, monkeypatch):
    monkeypatch.setattr(pictures, "MAX_PIXELS", 20 * 48 - 1)
    with refused("20 images of 6x8 pixels need", "smaller size"):
        load_dataset(images)
    monkeypatch.setattr(pictures, "MAX_PIXELS", 20 * 48)
    load_dataset(images)
    with refused("20 images of 1000000000x1000000000"):
        load_dataset(images, size=10**9)


def test_only_formats_that_are_listed_are_decoded(images):
    Image.new("L", (8, 6)).save(images / "cat" / "000.png", format="ICO")
    with refused("cat/000.png", "no image"):
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


@pytest.mark.parametrize("count", [0, 1, 21, -4])
def test_a_bad_number_of_images(split, count):
    with refused(f"{count} of 20 training images", "2 (one of each class) to 20"):
        load_dataset(split, images=count)


def test_options_that_other_sources_lack(images):
    for options, parts in (
        ({"images": 10}, ("10 training images", "own train and test folders")),
        ({"split": "blocks"}, ("a split was given", "hyperspectral")),
    ):
        with refused("pets", *parts):
            load_dataset(images, **options)
    with refused("digits: a number of images was given", "CIFAR-10"):
        load_dataset("digits", images=10)


def pack(folder, archive, root="", **options):
    with zipfile.ZipFile(archive, "w", **options) as file:
        for path in sorted(folder.rglob("*")):
            file.write(path, root + str(path.relative_to(folder)))
    return archive


@pytest.mark.parametrize("root", ["", "pets/", "a/b/"])
@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_zip_file_is_like_its_folder(images, tmp_path, root, method):
    (images / "cat" / "notes.txt").write_text("not an image")
    (images / "README.md").write_text("pets")
    path = pack(images, tmp_path / "zipped.zip", root, compression=method)
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("__MACOSX/cat/._000.png", b"what a Mac adds")
        file.writestr(".DS_Store", b"and this")
    data = load_dataset(path)
    assert data.hash == load_dataset(images).hash
    assert data.name == "zipped"
    assert load_dataset(path, size=(3, 2)).hash == load_dataset(images, size=(3, 2)).hash
    assert sorted(tmp_path.iterdir()) == sorted([images, path]), "never unpacked"


@pytest.mark.parametrize("root", ["", "split/"])
def test_a_zip_file_with_its_own_split(split, tmp_path, root):
    path = pack(split, tmp_path / "split.zip", root)
    for options in ({}, {"images": 6}):
        assert load_dataset(path, **options).hash == load_dataset(split, **options).hash


def test_a_zip_file_of_windows(images, tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as file:
        for image in images.rglob("*.png"):
            info = zipfile.ZipInfo("x")
            info.filename = "\\".join(image.relative_to(images).parts)
            file.writestr(info, image.read_bytes())
    assert load_dataset(path).hash == load_dataset(images).hash


@pytest.mark.parametrize(
    "name", ["/cat/0.png", "../cat/0.png", "cat/../../0.png", "C:/cat/0.png", "cat/a\nb.png", "/"]
)
def test_a_zip_file_with_a_trick_in_a_name(images, tmp_path, name):
    path = pack(images, tmp_path / "a.zip")
    with zipfile.ZipFile(path, "a") as file:
        info = zipfile.ZipInfo("x")
        info.filename = name
        file.writestr(info, (images / "cat" / "000.png").read_bytes())
    with refused(str(path), "no honest zip file", ascii(name)):
        load_dataset(path)


def test_a_zip_file_with_a_name_twice(images, tmp_path):
    path = pack(images, tmp_path / "a.zip")
    with zipfile.ZipFile(path, "a") as file, pytest.warns(UserWarning, match="Duplicate"):
        file.write(images / "cat" / "000.png", "cat/000.png")
    with refused("cat/000.png twice"):
        load_dataset(path)


ATTEMPTS = """
import sys
import deepfsi

def peak():
    return int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0]) / 1e3

honest, *bombs = sys.argv[1:]
deepfsi.load_dataset(honest, size=8)
plain = peak()
for path, part in zip(bombs[::2], bombs[1::2]):
    try:
        deepfsi.load_dataset(path, size=8)
    except deepfsi.InputError as error:
        assert part in str(error), error
    else:
        raise AssertionError(path)
    assert peak() < plain + 40, (path, peak(), plain)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads Linux's /proc")
def test_bombs_in_a_zip_file_cost_no_memory(images, tmp_path):
    honest = pack(images, tmp_path / "honest.zip")
    declared = pack(images, tmp_path / "declared.zip")
    with zipfile.ZipFile(declared, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        file.writestr("cat/zeros.png", bytes(300 * 2**20))
    lying = tmp_path / "lying.zip"
    size = (300 * 2**20).to_bytes(4, "little")
    assert declared.read_bytes().count(size) >= 1
    lying.write_bytes(declared.read_bytes().replace(size, (1000).to_bytes(4, "little")))
    huge = pack(images, tmp_path / "huge.zip")
    with zipfile.ZipFile(huge, "a") as file:
        file.writestr("cat/huge.png", HUGE_PNG)
    bombs = (declared, "would unpack", lying, "cannot read", huge, "bomb")
    words = [sys.executable, "-c", ATTEMPTS, *map(str, (honest, *bombs))]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def png_chunk(kind, content):
    length = len(content).to_bytes(4, "big")
    return length + kind + content + zlib.crc32(kind + content).to_bytes(4, "big")


def png_of(height, width):
    """The head of a PNG file that declares a size, and a little of its data."""

    sides = width.to_bytes(4, "big") + height.to_bytes(4, "big")
    return (
        b"\x89PNG\r\n\x1a\n"
        + png_chunk(b"IHDR", sides + bytes([8, 0, 0, 0, 0]))
        + png_chunk(b"IDAT", zlib.compress(bytes(10_000)))
        + png_chunk(b"IEND", b"")
    )


HUGE_PNG = png_of(60_000, 60_000)


def test_zip_files_that_cannot_be_read(images, tmp_path):
    path = tmp_path / "a.zip"
    whole = pack(images, path).read_bytes()
    entry = whole.index(b"\x89PNG")
    for content, part in (
        (b"", "as a zip file"),
        (b"no zip file", "as a zip file"),
        (whole[: len(whole) // 2], "as a zip file"),
        (whole[: entry + 30] + b"\0\0\0" + whole[entry + 33 :], "000.png (Bad CRC-32"),
    ):
        path.write_bytes(content)
        with refused(str(path), part):
            load_dataset(path)
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        pack(images, path, compression=method)
        with refused("cat/000.png", "unusual way"):
            load_dataset(path)
    encrypted = bytearray(whole)
    at = whole.index(b"PK\x01\x02", whole.index(b"cat/000.png", entry + 50) - 60)
    encrypted[at + 8] |= 1
    path.write_bytes(encrypted)
    with refused("cat/000.png", "encrypted"):
        load_dataset(path)


def test_zip_files_without_classes(images, tmp_path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("a.png", HUGE_PNG)
    with refused(str(path), "no sub-folders"):
        load_dataset(path)
    pack(images, path)
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("eel/notes.txt", "none yet")
    with refused(f"{path}/eel", "no images"):
        load_dataset(path)


ACUTE = "caf\u00e9"


def zipped(folder, path, flag=True):
    """A zip file of a folder, its names without the flag of UTF-8 if so, as macOS writes it."""
    with zipfile.ZipFile(path, "w") as file:
        for each in sorted(folder.rglob("*")):
            name = str(each.relative_to(folder)) + "/" * each.is_dir()
            content = b"" if each.is_dir() else each.read_bytes()
            file.writestr(name if flag else name.replace(ACUTE, "cafXX"), content)
    if not flag:
        path.write_bytes(path.read_bytes().replace(b"cafXX", ACUTE.encode()))
    return path


@pytest.mark.parametrize(
    "name", ["__MACOSX/cat/._000.png", "@eaDir/000.png", ".git/000.png", "$RECYCLE.BIN/a.png"]
)
def test_folders_of_systems_are_no_classes(images, tmp_path, name):
    whole = load_dataset(images)
    stray = images / name
    stray.parent.mkdir(parents=True)
    shutil.copy(next((images / "cat").iterdir()), stray)
    for extra in ("Thumbs.db", "desktop.ini", ".DS_Store", "cat/Thumbs.db", "cat/._000.png"):
        (images / extra).write_bytes(b"not an image")
    assert load_dataset(images).hash == whole.hash
    assert load_dataset(zipped(images, tmp_path / "a.zip")).hash == whole.hash


@pytest.mark.parametrize("name", ["000.png", "cat/night/000.JPG"])
def test_images_that_belong_to_no_class_are_named(images, tmp_path, name):
    (images / name).parent.mkdir(exist_ok=True)
    shutil.copy(next((images / "cat").iterdir()), images / name)
    for source in (images, zipped(images, tmp_path / "a.zip")):
        with refused("lie in no folder of a class", f"({name})", "move them"):
            load_dataset(source)


def test_images_beside_folders_of_images_are_not_shown_alone(images):
    shutil.copy(next((images / "cat").iterdir()), images / "preview.png")
    with refused("holds images and folders of images, such as cat"):
        read_display(images)


@pytest.mark.parametrize("names", [("train", "test"), ("Training", "Validation")])
def test_parts_of_a_data_set_are_no_classes(images, tmp_path, names):
    (images / "cat").rename(images / names[0])
    (images / "dog").rename(images / names[1])
    for source in (images, zipped(images, tmp_path / "a.zip")):
        with refused("name no classes", "put a folder of each class into train and test"):
            load_dataset(source)


def test_parts_may_have_capitals_and_others_are_named(split):
    whole = load_dataset(split)
    (split / "train").rename(split / "Train")
    (split / "test").rename(split / "Test")
    assert load_dataset(split).hash == whole.hash
    (split / "notes").mkdir()
    assert load_dataset(split).hash == whole.hash
    shutil.copytree(split / "Test", split / "val")
    with refused("outside of Test and Train", "val/"):
        load_dataset(split)


def test_a_class_in_two_unicode_spellings_is_one(images, tmp_path):
    (images / "cat").rename(images / unicodedata.normalize("NFD", ACUTE))
    one = load_dataset(images)
    (images / ACUTE).mkdir()
    for place in sorted((images / unicodedata.normalize("NFD", ACUTE)).iterdir())[:5]:
        place.rename(images / ACUTE / place.name)
    for source in (images, zipped(images, tmp_path / "a.zip")):
        data = load_dataset(source)
        assert data.classes == (ACUTE, "dog") or data.classes == ("dog", ACUTE)
        assert data.hash == one.hash


def test_names_of_a_mac_zip_are_utf_8(images, tmp_path):
    (images / "cat").rename(images / ACUTE)
    data = load_dataset(zipped(images, tmp_path / "a.zip", flag=False))
    assert data.hash == load_dataset(images).hash


def test_classes_that_differ_in_case_alone_are_refused(images):
    (images / "dog").rename(images / "Cat")
    with refused("'Cat' and 'cat' differ in case"):
        load_dataset(images)


def listed(images, path, first="", folder=""):
    """A .csv file of the images of class folders."""
    rows = [
        f"{folder}{each.relative_to(images)},{each.parent.name}" for each in images.rglob("*.png")
    ]
    path.write_text("\n".join([first, *sorted(rows)] if first else sorted(rows)) + "\n")
    return path


def test_a_table_of_file_names_and_labels(images, tmp_path):
    whole = load_dataset(images)
    for path in (
        listed(images, images / "labels.csv"),
        listed(images, images / "labels.csv", "file,label"),
        listed(images, tmp_path / "pets.csv", "file,label"),  # beside the folder of its name
        listed(images, tmp_path / "mine.csv", folder="pets/"),
    ):
        data = load_dataset(path)
        assert data.hash == whole.hash
        assert data.name == path.stem
        assert load_dataset(path, size=(3, 2)).image_shape == (3, 2)
    path.write_text("\ufeff" + path.read_text().replace(",", ";"))  # as Excel writes it in Europe
    assert load_dataset(path).hash == whole.hash


def test_a_bad_table_of_file_names_and_labels(images, tmp_path):
    path = tmp_path / "labels.csv"
    for text, parts in {
        "": ("names no image", "its file name and its label"),
        "a.jp2,cat\n": ("line 1", "'a.jp2, cat'", "is not an image and its label"),
        "label,file\ncat,pets/cat/000.png\n": ("line 2", "put the column of file names first"),
        ",file,label\n0,pets/cat/000.png,cat\n": ("line 2", "put the column of file names first"),
        'pets/cat/000.png,"cat\n': ("line 1", "unexpected end"),
        "0.1,0.9,2\n0.2,0.1,3\n": ("line 1", "'0.1, 0.9, 2'", "is not an image and its label"),
        "pets/cat/000.png,cat\npets/cat/001.png,\n": ("line 2", "is not an image and its label"),
        "file,label\n": ("names no image",),
        "pets/cat/000.png,cat\nx.png,cat\ny.png,dog\n": (
            "2 images that are not there",
            "x.png",
            "y",
        ),
        "pets/cat/000.png,cat\npets/cat/000.png,dog\n": ("cat/000.png twice",),
    }.items():
        path.write_text(text)
        with refused(str(path), *parts):
            load_dataset(path)
    path.write_bytes(b"\xff\xfe\x00")
    with refused(str(path), "not text in UTF-8"):
        load_dataset(path)
    with refused("only a folder, a zip file, CIFAR-10 or MNIST"):
        load_dataset(listed(images, path, folder="pets/"), images=5)


def valued(images, path, cells, heading=""):
    """A .csv file of all images, with the cells of each in the order of their names."""
    names = sorted(each.relative_to(images.parent).as_posix() for each in images.rglob("*.png"))
    rows = [",".join([name, *cells(place)]) for place, name in enumerate(names)]
    path.write_text("\n".join(filter(None, [heading, *rows])) + "\n")
    return path


@pytest.mark.parametrize(
    ("cells", "heading", "names"),
    [
        (lambda k: [f"{k}.5"], "", ("value 1",)),
        (lambda k: [f"{k}", f"{-k}e-1"], "file,row,column", ("row", "column")),
        (lambda k: [f"{k}", f"{2 * k}"], "", ("value 1", "value 2")),
    ],
)
def test_numbers_with_a_point_and_several_numbers_are_values(
    images, tmp_path, cells, heading, names
):
    data = load_dataset(valued(images, tmp_path / "places.csv", cells, heading))
    assert data.values == names
    assert data.classes == ()
    given = sorted(list(map(float, cells(k))) for k in range(20))
    held = np.concatenate([data.y_train, data.y_test])
    assert np.array(sorted(held.tolist())) == pytest.approx(np.array(given))


def test_each_picture_keeps_its_own_values(images, tmp_path):
    """The value of each is its mean level, which follows it through shuffle and split."""
    names = sorted(images.rglob("*.png"))
    means = [np.asarray(Image.open(name)).mean() / 255 for name in names]
    path = valued(images, tmp_path / "light.csv", lambda k: [f"{means[k]:.9f}"])
    data = load_dataset(path, rescale=(0, 1))
    for x, y in ((data.x_train, data.y_train), (data.x_test, data.y_test)):
        assert y[:, 0] == pytest.approx(x.mean(axis=1), abs=1e-6)


def test_whole_numbers_are_classes(images, tmp_path):
    data = load_dataset(valued(images, tmp_path / "counts.csv", lambda k: [str(k % 2)]))
    assert data.classes == ("0", "1")
    assert data.values == ()


def test_a_word_among_several_numbers_and_lines_of_other_lengths_are_refused(images, tmp_path):
    path = tmp_path / "places.csv"
    with refused(str(path), "2 columns beside the file name", "'far'"):
        load_dataset(valued(images, path, lambda k: ["1.5", "far" if k == 3 else "2"]))
    with refused(str(path), "line 5", "is not an image and its label"):
        load_dataset(valued(images, path, lambda k: ["1.5"] * (1 if k == 4 else 2)))
    with refused("places", "no finite number ('nan')"):
        load_dataset(valued(images, path, lambda k: ["nan" if k == 3 else "1.5"]))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize(("separator", "end"), [(",", "\n"), (";", "\r\n"), ("\t", "\r")])
def test_a_list_is_the_same_from_every_program(images, tmp_path, encoding, separator, end):
    (images / "dog").rename(images / "köter")
    path = listed(images, tmp_path / "mine.csv", "file,label,", folder="pets/")
    whole = load_dataset(path)
    assert whole.classes == ("cat", "köter")
    rows = path.read_text("utf-8").replace("/", "\\").replace(",", separator).split("\n")
    rows = [f"sep={separator}", *rows[:3], "", *(row and row + separator for row in rows[3:])]
    rows[1:4] = [rows[1], *(row + separator for row in rows[2:4])]
    path.write_bytes(end.join(rows).encode(encoding))
    assert load_dataset(path).hash == whole.hash


@pytest.mark.parametrize(
    ("labels", "classes"),
    [
        (("1_0", "1_1"), ("1_0", "1_1")),
        (("10_20", "3_4"), ("10_20", "3_4")),
        (("\uff11", "\uff12"), ("\uff11", "\uff12")),  # digits of other scripts
        (("+1", "-1"), ("+1", "-1")),
        (("0x10", "0x11"), ("0x10", "0x11")),
        (("True", "False"), ("False", "True")),
        (("0.5", "none"), ("0.5", "none")),
        (("nan", "inf"), ("inf", "nan")),
        (("cafe\u0301", "tea "), ("caf\u00e9", "tea")),
        (("a", "A"), ("A", "a")),  # letters to be read
        ((' "a, b"', '"c\nd"'), ("a, b", "c d")),
    ],
)
def test_words_that_python_takes_for_numbers_are_classes(images, tmp_path, labels, classes):
    data = load_dataset(valued(images, tmp_path / "q.csv", lambda k: [labels[k % 2]]))
    assert (data.classes, data.values) == (classes, ())


@pytest.mark.parametrize(
    ("labels", "said"),
    [
        (("1.0", "2.0"), "if they are classes, write one column of words or of numbers"),
        (("1e0", "2e0"), "if they are values, write their name over the column"),
        (("cat", "Cat"), "'Cat' and 'cat' differ in case"),
        (("big cat", "big  cat"), "differ in case, blanks"),
        (("cat", "cat."), "or a dot alone"),
        (("01", "1"), "zeros"),
        (("a", "a\u200b"), "differ in"),
        (("fi", "\ufb01"), "differ in"),
        (("0,1", "1,0"), "a single 1 in each row, as of classes in one-hot form"),
        (("0.5", "NA"), "no finite number ('NA')"),
        (("0.5", "#DIV/0!"), "no finite number ('#DIV/0!')"),
    ],
)
def test_labels_that_mislead_are_refused(images, tmp_path, labels, said):
    with refused(said):
        load_dataset(valued(images, tmp_path / "q.csv", lambda k: [labels[k % 2]]))


def test_a_heading_makes_whole_floats_values(images, tmp_path):
    path = tmp_path / "q.csv"
    assert load_dataset(valued(images, path, lambda k: [f"{k % 3}.0"], "file,row")).values == (
        "row",
    )
    with refused("whole numbers written as floats (0, 1, 2)"):
        load_dataset(valued(images, path, lambda k: [f"{k % 3}.0"], "file,label"))


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas_are_read_where_commas_part_no_cells(images, tmp_path, separator):
    path = valued(images, tmp_path / "q.csv", lambda k: [f"{k}.5"])
    points = load_dataset(path)
    path.write_text(path.read_text().replace(",", separator).replace(".5", ",5"))
    assert load_dataset(path).hash == points.hash


def test_a_comma_that_may_part_thousands_is_no_point(images, tmp_path):
    path = valued(images, tmp_path / "q.csv", lambda k: [f"{1 + k % 2}:234"])
    path.write_text(path.read_text().replace(",", ";").replace(":", ","))
    assert load_dataset(path).classes == ("1,234", "2,234")


def test_a_list_finds_files_in_the_other_spelling_and_case(images, tmp_path):
    (images / "cat").rename(images / "cafe\u0301")
    path = listed(images, tmp_path / "q.csv", folder="pets/")
    whole = load_dataset(path)
    for text in (
        unicodedata.normalize("NFC", path.read_text("utf-8")),
        path.read_text("utf-8").replace(".png", ".PNG"),
    ):
        path.write_text(text, "utf-8")
        assert load_dataset(path).hash == whole.hash
    (images / "dog" / "X.png").write_bytes(next((images / "dog").iterdir()).read_bytes())
    (images / "dog" / "x.png").write_bytes(b"")
    path.write_text("pets/dog/X.PNG,dog\n")
    with refused("1 images that are not there"):
        load_dataset(path)
