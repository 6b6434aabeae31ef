"""Indian Pines is made of the community's files; the simulated scene says so."""

from typing import Any

import numpy as np
import pytest
from dataset_samples import NM, refused
from scipy.io import savemat

from deepfsi.datasets import check, download, list_datasets, load_dataset
from deepfsi.datasets.indian_pines import CLASSES, WATER, load_scene


@pytest.fixture
def home(tmp_path, monkeypatch):
    """$DEEPFSI_DATA/indian_pines with the community's files, but for the values of the pixels."""
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    folder = tmp_path / "indian_pines"
    folder.mkdir()
    rng = np.random.default_rng(6)
    labels = np.kron(np.arange(1, 26).reshape(5, 5), np.ones((29, 29))).astype(np.uint8)
    labels[labels > 16] = 0
    cube = rng.integers(955, 9605, (145, 145, 220)).astype(np.uint16)
    arrays = {
        "indian_pines": cube,
        "indian_pines_corrected": np.delete(cube, WATER, axis=2),
        "indian_pines_gt": labels,
    }
    for name, array in arrays.items():
        savemat(folder / f"{name.capitalize()}.mat", {name: array}, do_compression=True)
    rows = [f"{nm:.6f}\t9.780000\t0.920000\t0.5\t{i + 2}" for i, nm in enumerate(NM)]
    (folder / "92AV3C.spc").write_text("\n".join(["FILE x", "------", *rows]) + "\n")
    return folder


@pytest.mark.parametrize(
    ("name", "bands"), [("indian-pines", 220), ("indian-pines-corrected", 200)]
)
def test_the_community_s_files(home, name, bands):
    data = load_dataset(name)
    assert data.name == name
    assert data.image_shape == (256,)
    assert data.classes == CLASSES
    assert len(data.x_train) + len(data.x_test) == 16 * 29 * 29
    assert f"{bands} bands, padded with darkness to 256" in data.preprocessing
    assert "mapped from [955, 9604] to [0, 1]" in data.preprocessing
    assert not data.x_test[:, bands:].any()
    assert data.x_test[:, :bands].any(axis=0).all()
    assert data.wavelengths is not None
    assert np.isnan(data.wavelengths[bands:]).all()
    kept = NM if bands == 220 else np.delete(NM, WATER)
    assert data.wavelengths[:bands].tolist() == kept.tolist()
    scene = load_scene(name)
    assert scene.cube.shape == (145, 145, bands)
    assert np.array_equal(
        load_dataset(name, split="blocks").x_test, scene.dataset("blocks", bands=256).x_test
    )
    assert download(name) == home
    assert all(result.ok for result in check(name))


def test_without_the_band_table_there_are_no_wavelengths(home):
    (home / "92AV3C.spc").unlink()
    assert load_dataset("indian-pines").wavelengths is None
    with refused("indian-pines-surrogate is not here", "92AV3C.spc and Indian_pines_gt.mat"):
        load_dataset("indian-pines-surrogate")


def test_the_corrected_bands_are_the_published_ones():
    given = [*range(104, 109), *range(150, 164), 220]  # counted from 1
    assert (WATER + 1).tolist() == given


def test_what_is_missing_is_named(home):
    (home / "Indian_pines.mat").unlink()
    with refused("Indian_pines.mat and Indian_pines_gt.mat", "indian_pines", "DEEPFSI_DATA"):
        load_dataset("indian-pines")
    assert [result.ok for result in check("indian-pines")] == [False, True]
    where = {info.name: info.where for info in list_datasets()}
    assert where["indian-pines"] == "not here"
    assert where["indian-pines-corrected"] == str(home)


def test_files_of_something_else(home):
    cases: list[tuple[str, Any, str]] = [
        ("Indian_pines.mat", {"indian_pines": np.ones((145, 145, 5))}, "5 bands, not 220"),
        ("Indian_pines.mat", {"salinas": np.ones((145, 145, 220))}, "variable 'indian_pines'"),
        ("Indian_pines_gt.mat", {"indian_pines_gt": np.ones((145, 144))}, "(145, 144)"),
        ("Indian_pines_gt.mat", {"indian_pines_gt": np.eye(145) + 1}, "labels 0 to 16"),
    ]
    for file, content, part in cases:
        whole = (home / file).read_bytes()
        savemat(home / file, content)
        for name in ("indian-pines", "indian-pines-surrogate"):
            if name == "indian-pines-surrogate" and file == "Indian_pines.mat":
                continue
            with refused(part if name == "indian-pines" else file):
                load_dataset(name)
            assert not all(result.ok for result in check(name))
        (home / file).write_bytes(whole)
    for content in ("FILE x\n---\n", "FILE x\n---\n400 9\n500 9\n", "FILE x\n---\nfour 9\n"):
        (home / "92AV3C.spc").write_text(content)
        with refused("92AV3C.spc", "replace it with the original"):
            load_dataset("indian-pines")


def test_the_simulated_scene_says_so_everywhere(home):
    data = load_dataset("indian-pines-surrogate")
    assert data.name == "indian-pines-surrogate"
    assert "Simulated" in data.preprocessing
    assert "not the real scene" in data.preprocessing
    assert data.image_shape == (256,)
    assert load_scene("indian-pines-surrogate").name == "indian-pines-surrogate"
    assert load_dataset("indian-pines").name != data.name
