"""Indian Pines is found in the user's folder or in tensorly's, and checked by its values."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_samples import NM, refused
from scipy.io import savemat

from deepfsi.datasets import check, download, list_datasets, load_dataset, load_indian_pines
from deepfsi.datasets.catalog import DATASETS, restore_high_bytes, values_hash

INDIAN_PINES = DATASETS["indian-pines"]
REAL = Path(os.environ.get("DEEPFSI_DATA") or ".") / "indian_pines"


def made_up():
    """Cube and label map of the scene's size, other values."""
    labels = np.kron(np.arange(1, 26).reshape(5, 5), np.ones((29, 29))).astype(np.uint8)
    labels[labels > 16] = 0
    cube = np.random.default_rng(6).integers(955, 9605, (145, 145, 200)).astype(np.uint16)
    return {INDIAN_PINES.CUBE: cube, INDIAN_PINES.LABELS: labels}


def write(folder, arrays, ending):
    for stem, values in arrays.items():
        if ending == ".npy":
            np.save(folder / f"{stem}.npy", values)
        else:
            savemat(folder / f"{stem}.mat", {stem.lower(): values}, do_compression=True)


@pytest.fixture(params=[".npy", ".mat"])
def home(request, tmp_path, monkeypatch):
    """$DEEPFSI_DATA/indian_pines with files of either kind, and their hashes in place."""
    folder = tmp_path / "indian_pines"
    folder.mkdir()
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    for stem, values in made_up().items():
        monkeypatch.setitem(INDIAN_PINES.hashes, stem, values_hash(values))
    write(folder, made_up(), request.param)
    rows = [f"{nm:.6f}\t9.780000\t0.920000\t0.5\t{i + 2}" for i, nm in enumerate(NM)]
    (folder / "92AV3C.spc").write_text("\n".join(["FILE x", "------", *rows]) + "\n")
    return folder


def test_the_scene_of_a_folder(home):
    data = load_dataset("indian-pines")
    assert data.name == "indian-pines"
    assert data.image_shape == (256,)
    assert data.classes == INDIAN_PINES.classes
    assert len(data.x_train) + len(data.x_test) == 16 * 29 * 29
    assert "200 of 220 bands" in data.preprocessing
    assert "padded with darkness to 256" in data.preprocessing
    assert "mapped from [955, 9604] to [0, 1]" in data.preprocessing
    assert not data.x_test[:, 200:].any()
    assert data.x_test[:, :200].any(axis=0).all()
    assert data.wavelengths is not None
    assert np.isnan(data.wavelengths[200:]).all()
    assert data.wavelengths[:200].tolist() == np.delete(NM, INDIAN_PINES.WATER).tolist()
    scene = load_indian_pines()
    assert np.array_equal(scene.cube, made_up()[INDIAN_PINES.CUBE])
    blocks = load_dataset("indian-pines", split="blocks")
    assert np.array_equal(blocks.x_test, scene.dataset("blocks", bands=256).x_test)
    assert download("indian-pines") == home
    assert [each.ok for each in check("indian-pines")] == [True, True]


def test_without_the_band_table_there_are_no_wavelengths(home):
    (home / "92AV3C.spc").unlink()
    assert load_dataset("indian-pines").wavelengths is None


def test_the_corrected_bands_are_the_published_ones():
    given = [*range(104, 109), *range(150, 164), 220]  # counted from 1
    assert (INDIAN_PINES.WATER + 1).tolist() == given


def test_other_values_are_refused(home):
    cube, labels = made_up().values()
    one_off = cube.copy()
    one_off[7, 8, 9] += 1
    for stem, values in (
        (INDIAN_PINES.CUBE, one_off),
        (INDIAN_PINES.CUBE, cube / 9604),
        (INDIAN_PINES.LABELS, labels.T),
    ):
        ending = next(home.glob(f"{stem}.*")).suffix
        write(home, {stem: values}, ending)
        with refused(f"{stem}{ending} does not hold the values", "replace it with the original"):
            load_dataset("indian-pines")
        assert sum(each.ok for each in check("indian-pines")) == 1
        write(home, {stem: made_up()[stem]}, ending)
    for content in ("FILE x\n---\n", "FILE x\n---\n400 9\n500 9\n", "FILE x\n---\nfour 9\n"):
        (home / "92AV3C.spc").write_text(content)
        with refused("92AV3C.spc", "replace it with the original"):
            load_dataset("indian-pines")


def test_files_that_are_no_scene_are_named(home):
    cases: list[tuple[str, Any]] = [
        (INDIAN_PINES.CUBE, np.ones((145, 145))),
        (INDIAN_PINES.LABELS, np.ones((145, 144))),
    ]
    for stem, values in cases:
        ending = next(home.glob(f"{stem}.*")).suffix
        write(home, {stem: values}, ending)
        with refused("dimension" if (stem, ending) == (INDIAN_PINES.CUBE, ".mat") else "145"):
            load_dataset("indian-pines")
        assert not all(each.ok for each in check("indian-pines"))
        write(home, {stem: made_up()[stem]}, ending)


def test_what_is_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    monkeypatch.setattr(INDIAN_PINES, "PACKAGE", ("no_such_package", "datasets/data"))
    with refused(
        "pip install",
        f"{INDIAN_PINES.CUBE}.mat and {INDIAN_PINES.LABELS}.mat",
        "indian_pines",
        "DEEPFSI_DATA",
    ):
        load_dataset("indian-pines")
    assert [result.ok for result in check("indian-pines")] == [False, False]
    assert {info.name: info.where for info in list_datasets()}["indian-pines"] == "not here"


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    """The scene of the package's copy."""
    pytest.importorskip("tensorly")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DEEPFSI_DATA", str(tmp_path_factory.mktemp("empty")))
        return load_indian_pines()


def test_the_scene_in_tensorly(real, tmp_path, monkeypatch):
    """The package's copy is the real scene: its numbers of pixels, lowest and highest value."""
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    scene = real
    assert scene.cube.shape == (145, 145, 200)
    assert (scene.cube.min(), scene.cube.max()) == (955, 9604)
    counts = np.bincount(scene.labels.ravel())
    assert (counts[1:].sum(), counts[1], counts[9], counts[11]) == (10_249, 46, 20, 2455)
    assert all(result.ok for result in check("indian-pines"))
    assert download("indian-pines").parts[-3:] == ("tensorly", "datasets", "data")


def smooth_cube():
    """Spectra that are combinations of four, with noise, whose high bytes include 10 to 13."""
    rng = np.random.default_rng(3)
    shares = rng.dirichlet(np.ones(4), 60 * 60)
    ends = np.cumsum(rng.normal(0, 120, (4, 40)), axis=1) + 3300
    spectra = shares @ ends + rng.normal(0, 25, (60 * 60, 40))
    return np.clip(spectra, 1000, 9000).astype(np.uint16).reshape(60, 60, 40)


def as_text(cube):
    """The cube after its bytes were written as those of a text."""
    content = cube.astype("<u2").tobytes().replace(b"\r", b"\n")
    return np.frombuffer(content, "<u2").reshape(cube.shape)


def test_bytes_that_became_line_feeds_are_restored():
    """Values 768 apart are told by the other bands, whose noise of 25 is a fifteenth of half that.

    Low bytes 13 stay 10, so that a value may be wrong by 3.
    """
    cube = smooth_cube()
    lost = as_text(cube)
    changed = (cube >> 8) == 13
    assert changed.mean() > 0.05
    assert (((lost >> 8) == 10) & ~changed).mean() > 0.001, "both kinds are there"
    assert values_hash(lost) == values_hash(cube)
    wrong = np.abs(restore_high_bytes(lost).astype(int) - cube) > 3
    assert wrong.mean() < 1e-3


def test_the_real_copy_lost_its_carriage_returns(real):
    """Few values stick out once restored; another pair of bytes shows how many are wrong."""
    import tensorly

    path = Path(tensorly.__file__).parent / "datasets" / "data" / f"{INDIAN_PINES.CUBE}.npy"
    assert b"\r" not in path.read_bytes()[128:]
    lost, cube = np.load(path).astype(int), real.cube.astype(int)
    dips = [(2 * each[..., 12] - each[..., 11] - each[..., 13] < -1000) for each in (lost, cube)]
    assert dips[0].sum() > 1000
    assert dips[1].sum() < 20
    assert set(np.unique(cube - lost)) == {0, 768}
    cube = cube[:72]  # half of the scene is enough
    undone = np.where((cube >> 8) == 18, cube - 768, cube).astype(np.uint16)
    wrong = restore_high_bytes(undone, 15) != cube
    assert wrong.sum() < 1e-3 * ((undone >> 8) == 15).sum()


@pytest.mark.skipif(not REAL.is_dir(), reason="needs $DEEPFSI_DATA/indian_pines")
def test_a_folder_goes_before_the_package():
    assert download("indian-pines") == REAL
    assert all(result.ok for result in check("indian-pines"))
    assert load_dataset("indian-pines").wavelengths is not None
