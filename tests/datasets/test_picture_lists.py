"""Images that a .csv file names, with their labels."""

import unicodedata

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
