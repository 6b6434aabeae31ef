"""Folders and zip files of images: which folders are classes, and which are none."""

import shutil
import unicodedata
import zipfile

import pytest
from dataset_samples import refused

from deepfsi.datasets import load_dataset, read_display

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
