"""Images that a .csv file names, with their labels."""

from dataset_samples import refused

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
