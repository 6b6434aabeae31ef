"""Cubes and label maps are read from files of a user's own."""

from pathlib import Path

import numpy as np
import pytest
from dataset_samples import IMAGE, LABELS, numbered, refused
from scipy.io import savemat
from spectral.io import envi

from deepfsi.datasets import cubes, load_dataset
from deepfsi.datasets.cubes import read_cube


def test_files_side_by_side(tmp_path):
    cube = numbered(LABELS)
    savemat(tmp_path / "farm_corrected.mat", {"farm_corrected": cube, "note": "a word"})
    savemat(tmp_path / "farm_gt.mat", {"farm_gt": LABELS.astype(float)}, do_compression=True)
    np.save(tmp_path / "plot.npy", cube)
    np.save(tmp_path / "plot_gt.npy", LABELS)
    for name in ("farm_corrected.mat", "plot.npy"):
        data = load_dataset(tmp_path / name, split="blocks", seed=2)
        assert data.hash == IMAGE.dataset("blocks", 2).hash
        assert data.name == Path(name).stem
        assert load_dataset(tmp_path / name).hash == IMAGE.dataset().hash
        assert np.array_equal(read_cube(tmp_path / name).labels, LABELS)
    mixed = read_cube(tmp_path / "plot.npy", tmp_path / "farm_gt.mat", name="mixed")
    assert mixed.dataset().hash == IMAGE.dataset().hash


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
def test_envi(tmp_path, interleave):
    metadata = {"wavelength": [0.4, 0.5, 0.6, 0.7, 0.8], "wavelength units": "Micrometers"}
    envi.save_image(
        str(tmp_path / "farm.hdr"), numbered(LABELS), metadata=metadata, interleave=interleave
    )
    envi.save_classification(
        str(tmp_path / "farm_gt.hdr"), LABELS, class_names=["none", "oak", "ash", "elm", "yew"]
    )
    image = read_cube(tmp_path / "farm.hdr")
    assert image.class_names == ("oak", "ash", "elm", "yew")
    assert image.wavelengths is not None
    assert image.wavelengths == pytest.approx([400, 500, 600, 700, 800])
    assert np.array_equal(image.cube, numbered(LABELS))
    assert np.array_equal(load_dataset(tmp_path / "farm.hdr").x_test, IMAGE.dataset().x_test)

    data_file = tmp_path / "farm.img"
    data_file.write_bytes(data_file.read_bytes()[:-10])
    with refused("farm.hdr as ENVI", "less than the header says"):
        load_dataset(tmp_path / "farm.hdr")
    (tmp_path / "farm.hdr").write_text("not ENVI")
    with refused("farm.hdr as ENVI"):
        load_dataset(tmp_path / "farm.hdr")


def test_envi_without_its_package(tmp_path, monkeypatch):
    (tmp_path / "a.hdr").write_text("ENVI")
    np.save(tmp_path / "a_gt.npy", LABELS)
    monkeypatch.setitem(__import__("sys").modules, "spectral.io", None)
    with refused("pip install spectral"):
        load_dataset(tmp_path / "a.hdr")


def test_files_that_do_not_serve(tmp_path, monkeypatch):
    cube = numbered(LABELS)
    path = tmp_path / "a.mat"

    def refuse(*parts):
        with refused(*parts):
            load_dataset(path)

    savemat(path, {"a": cube})
    refuse("no label map beside it", "a_gt", ".mat or .npy or .hdr")
    np.save(tmp_path / "a_gt.npy", LABELS)
    load_dataset(path)
    savemat(path, {"a": cube, "b": cube})
    refuse("not one variable alone", "a, b: save a 3-dimensional one alone")
    savemat(path, {"a": LABELS, "word": "cube", "cell": np.array([cube], object)})
    refuse("in 3 dimensions", "but none")
    savemat(path, {"a": np.zeros((60, 60, 2000), np.uint8)}, do_compression=True)
    monkeypatch.setattr(cubes, "MAX_VALUES", 60 * 60 * 2000 - 1)
    refuse("(60, 60, 2000)", "or fewer")
    monkeypatch.undo()
    path.write_bytes(path.read_bytes()[:200])
    refuse("cannot read", "a.mat")
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400))
    refuse("7.3", "-v7")
    path.write_bytes(b"")
    refuse("cannot read", "a.mat")

    path = tmp_path / "a.npy"
    np.save(path, np.full((60, 60, 5), None), allow_pickle=True)
    refuse("cannot read", "a.npy")
    np.save(path, cube)
    path.write_bytes(path.read_bytes()[:-5])
    refuse("cannot read", "a.npy")
    np.save(path, cube[..., 0])
    refuse("(60, 60)", "(height, width, bands)")


def test_a_missing_file(tmp_path):
    with refused("a.mat", "no file"):
        load_dataset(tmp_path / "a.mat")
    with refused("'indian-pines'?"):
        load_dataset("indian-pine")
