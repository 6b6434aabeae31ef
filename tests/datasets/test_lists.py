"""A list of pictures is read as their folder is; labels are numbers only if written as such."""

import numpy as np
import pytest
from dataset_samples import not_loaded

from deepfsi.datasets.load import load_dataset


def listed(images, path, labels, heading=""):
    """A list of all images, with the labels that a function gives to their numbers and names."""
    names = sorted(each.relative_to(images).as_posix() for each in images.rglob("*.png"))
    lines = [f"{name},{labels(number, name)}" for number, name in enumerate(names)]
    path.write_text("\n".join([heading, *lines]) if heading else "\n".join(lines), "utf-8")
    return path


def folder_of(number, name):
    return name.split("/")[0]


@pytest.mark.parametrize("heading", ["", "file,label"])
@pytest.mark.parametrize("place", ["pets.csv", "pets/labels.csv"])
def test_a_list_gives_what_the_folder_of_its_pictures_gives(images, heading, place):
    path = listed(images, images.parent / place, folder_of, heading)
    whole = load_dataset(images)
    assert load_dataset(path).hash == whole.hash
    assert load_dataset(path, size=(3, 2)).image_shape == (3, 2)
    windows = path.read_text().replace("/", "\\").replace(",", ";")
    path.write_text(windows, "utf-16")
    assert load_dataset(path).hash == whole.hash
    not_loaded(path, "takes no `images`", images=5)


@pytest.mark.parametrize("labels", [("1_0", "1_1"), ("+1", "-1"), ("0x10", "0x11"), ("1e5", "2e5")])
def test_what_is_no_decimal_number_is_a_class(images, labels):
    data = load_dataset(listed(images, images.parent / "pets.csv", lambda k, _: labels[k % 2]))
    assert (data.classes, data.values) == (labels, ())


@pytest.mark.parametrize(
    ("values", "heading", "names"),
    [
        (lambda k, _: f"{k}.5", "", ("value 1",)),
        (lambda k, _: f"{k % 3}.0", "file,row", ("row",)),
        (lambda k, _: f"{k},{-k}e-01", "file,row,column", ("row", "column")),
    ],
)
def test_decimal_numbers_are_values(images, values, heading, names):
    data = load_dataset(listed(images, images.parent / "pets.csv", values, heading))
    assert (data.values, data.classes) == (names, ())
    given = sorted([float(value) for value in values(k, "").split(",")] for k in range(20))
    truth = np.concatenate([data.y_train, data.y_test])
    assert np.array(sorted(truth.tolist())) == pytest.approx(np.array(given))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "one whole line"),
        ("cat/000.png,cat\ncat/001.png,\n", "one whole line"),
        ("cat/000.png,cat\ncat/000.png,dog\n", "one whole line"),
        ("cat/000.png,1,2\ncat/001.png,3,far\n", "one whole line"),
        ("cat/000.png,cat\nx.png,cat\n", "x.png is missing"),
        ("file,label\ncat/000.png,1.0\ncat/001.png,2.0\n" + "".join(
            f"{label}/{k:03}.png,{k % 2}.0\n" for label in ("cat", "dog") for k in range(2, 10)
        ), "whole numbers written as floats"),
    ],
)  # fmt: skip
def test_a_bad_list_is_one_line(images, text, said):
    path = images.parent / "pets.csv"
    path.write_text(text)
    not_loaded(path, said)
