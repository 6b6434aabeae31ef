"""Images that a .csv file names, with their labels."""

import numpy as np
import pytest
from dataset_samples import refused
from PIL import Image

from deepfsi.datasets import load_dataset


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
        "": ("cannot read", "its file name and its label"),
        "0.1,0.9,2\n0.2,0.1,3\n": ("line 2", "'0.2, 0.1, 3'", "is not an image and its label"),
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
    with refused(str(path), "cannot read"):
        load_dataset(path)
    with refused("only a folder, a zip file or CIFAR-10"):
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
    with refused("places", "finite numbers"):
        load_dataset(valued(images, path, lambda k: ["nan" if k == 3 else "1.5"]))
