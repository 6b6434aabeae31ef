"""Hyperspectral images become scenes with honest splits; the simulated one says so."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.io import savemat
from scipy.ndimage import distance_transform_cdt
from spectral.io import envi

from deepfsi.datasets import (
    SpectralImage,
    check,
    cubes,
    download,
    indian_pines,
    list_datasets,
    load_dataset,
    load_spectra,
    surrogate,
)
from deepfsi.datasets.cubes import read_cube
from deepfsi.errors import InputError

REAL = Path(os.environ.get("DEEPFSI_DATA") or ".") / "indian_pines"
real_labels = pytest.mark.skipif(
    not all((REAL / file).is_file() for file in ("Indian_pines_gt.mat", "92AV3C.spc")),
    reason="needs the label map and band table in $DEEPFSI_DATA/indian_pines",
)


def one_line(error: pytest.ExceptionInfo[InputError], *parts: str) -> None:
    message = str(error.value)
    assert "\n" not in message
    for part in parts:
        assert part in message


def fields(side: int = 60, classes: int = 4) -> npt.NDArray[np.uint8]:
    """A label map of square fields with unlabelled paths between them."""
    labels = np.zeros((side, side), np.uint8)
    step = side // 4
    for i in range(4):
        for j in range(4):
            inside = slice(i * step, (i + 1) * step - 1), slice(j * step, (j + 1) * step - 1)
            labels[inside] = 1 + (i + j) % classes
    return labels


def numbered(labels: npt.NDArray[Any], bands: int = 5) -> npt.NDArray[np.int16]:
    """A cube whose first two bands tell the row and column, the last the class."""
    cube = np.full((*labels.shape, bands), 30, np.int16)
    cube[..., 0], cube[..., 1] = np.indices(labels.shape)
    cube[..., -1] = labels * 20
    cube[0, 0, 2], cube[-1, -1, 2] = -100, 300  # what becomes 0 and 1
    return cube


def pixels(x: npt.NDArray[np.float32]) -> list[tuple[int, int]]:
    """Rows and columns of the scenes of a numbered cube."""
    return [(int(i), int(j)) for i, j in np.rint(x[:, :2] * 400 - 100)]


LABELS = fields()
IMAGE = SpectralImage("farm", numbered(LABELS), LABELS)


# ---------------------------------------------------------------- scenes and splits


@pytest.mark.parametrize("split", ["random", "blocks"])
def test_each_labelled_pixel_is_a_scene(split: str) -> None:
    data = IMAGE.dataset(split, bands=8)
    assert data.image_shape == (8,)
    assert data.classes == ("1", "2", "3", "4")
    assert data.x_train.dtype == np.float32
    assert data.y_train.dtype == np.int64
    for x, y in ((data.x_train, data.y_train), (data.x_test, data.y_test)):
        assert np.allclose(x[:, 3], 130 / 400)
        assert np.allclose(x[:, 4], (20 * (y + 1) + 100) / 400)
        assert not x[:, 5:].any(), "the padding is dark"
        assert [LABELS[i, j] - 1 for i, j in pixels(x)] == y.tolist()
    assert pixels(data.x_test) == sorted(pixels(data.x_test))
    assert pixels(data.x_train) != sorted(pixels(data.x_train)), "shuffled"
    assert not set(pixels(data.x_train)) & set(pixels(data.x_test))
    assert data.preprocessing.startswith(
        "Spectra mapped from [-100, 300] to [0, 1], 5 bands, padded with darkness to 8;"
    )
    assert data.hash == IMAGE.dataset(split, bands=8).hash
    assert data.hash != IMAGE.dataset(split, bands=8, seed=1).hash


def test_the_random_split_is_a_stratified_fifth() -> None:
    train, test = IMAGE.parts("random", 3)
    assert np.array_equal(train | test, LABELS > 0)
    for label in range(1, 5):
        share = test[label == LABELS].mean()
        assert share == pytest.approx(0.2, abs=1 / np.count_nonzero(label == LABELS))
    data = IMAGE.dataset("random", 3)
    assert sorted(pixels(data.x_train)) == [tuple(p) for p in np.argwhere(train).tolist()]


@pytest.mark.parametrize("seed", range(4))
def test_the_blocks_are_apart(seed: int) -> None:
    train, test = IMAGE.parts("blocks", seed)
    assert not (train & test).any()
    away = distance_transform_cdt(~test, metric="chessboard")
    assert away[train].min() == 2, "one pixel between them, and no more is lost"
    left_out = (LABELS > 0) & ~train & ~test
    assert (away[left_out] == 1).all()
    assert np.array_equal(np.unique(LABELS[train]), [1, 2, 3, 4])
    assert np.array_equal(np.unique(LABELS[test]), [1, 2, 3, 4])
    assert test.sum() == pytest.approx(0.2 * (LABELS > 0).sum(), rel=0.3)
    random = distance_transform_cdt(~IMAGE.parts("random", seed)[1], metric="chessboard")
    assert random[IMAGE.parts("random", seed)[0]].min() == 1


def test_a_class_in_one_block_is_trained_on() -> None:
    labels = fields()
    labels[:3, :3] = 5
    for seed in range(3):
        train, _ = SpectralImage("farm", numbered(labels), labels).parts("blocks", seed)
        assert (labels[train] == 5).any()


def test_the_map_and_the_scenes_agree() -> None:
    every = IMAGE.scenes(8)
    assert every.shape == (3600, 8)
    data = IMAGE.dataset(bands=8)
    for row, (i, j) in zip(data.x_test[:20], pixels(data.x_test[:20]), strict=True):
        assert np.array_equal(row, every[60 * i + j])


def test_reflectance_is_left_as_it_is() -> None:
    cube = np.random.default_rng(2).uniform(0.2, 0.7, (60, 60, 4))
    data = SpectralImage("farm", cube, LABELS).dataset()
    assert np.allclose(IMAGE.parts()[1][LABELS > 0].sum(), len(data.x_test))
    assert np.array_equal(data.x_test, cube[IMAGE.parts()[1]].astype(np.float32))
    assert data.preprocessing.startswith("Spectra, 4 bands; a random stratified fifth")
    counts = SpectralImage("farm", (cube * 1000).astype(np.uint16), LABELS).dataset()
    assert (counts.x_train.min(), counts.x_train.max()) == pytest.approx((0, 1), abs=0.01)


def test_classes_and_wavelengths() -> None:
    wavelengths = np.arange(400.0, 900, 100)
    names = ("oak", "ash", "elm", "yew", "fir")
    data = SpectralImage("farm", numbered(LABELS), LABELS, names, wavelengths).dataset(bands=8)
    assert data.classes == names[:4], "fir has no pixel"
    assert data.wavelengths is not None
    assert data.wavelengths[:5].tolist() == wavelengths.tolist()
    assert np.isnan(data.wavelengths[5:]).all()
    assert data.hold_out().wavelengths is data.wavelengths
    assert IMAGE.dataset().wavelengths is None
    gaps = np.where(LABELS == 2, 9, LABELS)
    assert SpectralImage("farm", numbered(LABELS), gaps).class_names == ("1", "3", "4", "9")


def bad(**changes: Any) -> SpectralImage:
    return SpectralImage(**{"name": "farm", "cube": numbered(LABELS), "labels": LABELS, **changes})


NAN = numbered(LABELS).astype(float)
NAN[3, 3, 3] = np.nan


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"cube": LABELS}, ("the cube is uint8 of shape (60, 60)", "(height, width, bands)")),
        ({"cube": numbered(LABELS) > 3}, ("the cube is bool",)),
        ({"cube": numbered(LABELS)[:, :, :0]}, ("(60, 60, 0)",)),
        ({"cube": NAN}, ("NaN",)),
        ({"labels": LABELS[:-1]}, ("label map is uint8 of shape (59, 60)", "(60, 60)")),
        ({"labels": LABELS / 2}, ("label map is float64",)),
        ({"labels": LABELS * 0}, ("0 classes",)),
        ({"labels": LABELS // 4}, ("1 classes", "two or more")),
        ({"classes": ("a", "b")}, ("1, 2, 3, 4 for 2 class names",)),
        ({"wavelengths": np.arange(4.0)}, ("4 wavelengths for 5 bands",)),
    ],
)
def test_images_that_do_not_fit(changes: dict[str, Any], parts: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as error:
        bad(**changes)
    one_line(error, "farm", *parts)


def test_options_that_cannot_be() -> None:
    small = np.zeros((60, 60), np.uint8)
    small[:4, 0], small[9:20, 9:20] = 1, 2
    one_block = np.zeros((60, 60), np.uint8)
    one_block[:4, :2], one_block[:4, 2:4] = 1, 2
    for attempt, parts in (
        (lambda: IMAGE.parts("block"), ("unknown split 'block'", "'blocks'")),
        (lambda: IMAGE.parts("random", -1), ("seed -1",)),
        (lambda: IMAGE.scenes(4), ("5 bands cannot be padded to 4",)),
        (lambda: bad(labels=small).parts(), ("class '1' has 4 pixels", "5 or more")),
        (lambda: bad(labels=one_block).parts("blocks"), ("fewer than 5 blocks", "at random")),
        (lambda: bad(cube=np.full((60, 60, 3), 7)).scenes(), ("every value of the cube is 7",)),
    ):
        with pytest.raises(InputError) as error:
            attempt()
        one_line(error, *parts)


# ---------------------------------------------------------------- files of a user's own


def test_files_side_by_side(tmp_path: Path) -> None:
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
        assert np.array_equal(load_spectra(tmp_path / name).labels, LABELS)
    mixed = read_cube(tmp_path / "plot.npy", tmp_path / "farm_gt.mat", name="mixed")
    assert mixed.dataset().hash == IMAGE.dataset().hash


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
def test_envi(tmp_path: Path, interleave: str) -> None:
    metadata = {"wavelength": [0.4, 0.5, 0.6, 0.7, 0.8], "wavelength units": "Micrometers"}
    envi.save_image(
        str(tmp_path / "farm.hdr"), numbered(LABELS), metadata=metadata, interleave=interleave
    )
    envi.save_classification(
        str(tmp_path / "farm_gt.hdr"),
        LABELS,
        class_names=["none", "oak", "ash", "elm", "yew"],
    )
    image = load_spectra(tmp_path / "farm.hdr")
    assert image.class_names == ("oak", "ash", "elm", "yew")
    assert image.wavelengths is not None
    assert image.wavelengths == pytest.approx([400, 500, 600, 700, 800])
    assert np.array_equal(image.cube, numbered(LABELS))
    assert np.array_equal(load_dataset(tmp_path / "farm.hdr").x_test, IMAGE.dataset().x_test)

    data_file = tmp_path / "farm.img"
    data_file.write_bytes(data_file.read_bytes()[:-10])
    with pytest.raises(InputError) as error:
        load_dataset(tmp_path / "farm.hdr")
    one_line(error, "farm.hdr as ENVI", "less than the header says")
    (tmp_path / "farm.hdr").write_text("not ENVI")
    with pytest.raises(InputError) as error:
        load_dataset(tmp_path / "farm.hdr")
    one_line(error, "farm.hdr as ENVI")


def test_envi_without_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.hdr").write_text("ENVI")
    np.save(tmp_path / "a_gt.npy", LABELS)
    monkeypatch.setitem(__import__("sys").modules, "spectral.io", None)
    with pytest.raises(InputError) as error:
        load_dataset(tmp_path / "a.hdr")
    one_line(error, "pip install deepfsi[spectral]")


def test_files_that_do_not_serve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cube = numbered(LABELS)
    path = tmp_path / "a.mat"

    def refused(*parts: str) -> None:
        with pytest.raises(InputError) as error:
            load_dataset(path)
        one_line(error, *parts)

    savemat(path, {"a": cube})
    refused("no label map beside it", "a_gt", ".mat or .npy or .hdr")
    np.save(tmp_path / "a_gt.npy", LABELS)
    load_dataset(path)
    savemat(path, {"a": cube, "b": cube})
    refused("the only one", "a, b")
    savemat(path, {"a": LABELS, "word": "cube", "cell": np.array([cube], object)})
    refused("3-dimensional variable", "it holds nothing")
    savemat(path, {"a": np.zeros((60, 60, 2000), np.uint8)}, do_compression=True)
    monkeypatch.setattr(cubes, "MAX_VALUES", 60 * 60 * 2000 - 1)
    refused("(60, 60, 2000)", "or fewer")
    monkeypatch.undo()
    path.write_bytes(path.read_bytes()[:200])
    refused("cannot read", "a.mat")
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400))
    refused("7.3", "-v7")
    path.write_bytes(b"")
    refused("cannot read", "a.mat")

    path = tmp_path / "a.npy"
    np.save(path, np.full((60, 60, 5), None), allow_pickle=True)
    refused("cannot read", "a.npy")
    np.save(path, cube)
    path.write_bytes(path.read_bytes()[:-5])
    refused("cannot read", "a.npy")
    np.save(path, cube[..., 0])
    refused("(60, 60)", "(height, width, bands)")


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        load_spectra(tmp_path / "a.mat")
    one_line(error, "a.mat", "no file")
    with pytest.raises(InputError) as error:
        load_spectra("indian-pine")
    one_line(error, "'indian-pines'?")


# ---------------------------------------------------------------- Indian Pines


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """$DEEPFSI_DATA/indian_pines with the community's files, but for the values of the pixels."""
    monkeypatch.setenv("DEEPFSI_DATA", str(tmp_path))
    folder = tmp_path / "indian_pines"
    folder.mkdir()
    rng = np.random.default_rng(6)
    labels = np.kron(np.arange(1, 26).reshape(5, 5), np.ones((29, 29))).astype(np.uint8)
    labels[labels > 16] = 0
    cube = rng.integers(955, 9605, (145, 145, 220)).astype(np.uint16)
    corrected = np.delete(cube, indian_pines.WATER, axis=2)
    for name, array in (
        ("indian_pines", cube),
        ("indian_pines_corrected", corrected),
        ("indian_pines_gt", labels),
    ):
        savemat(folder / f"{name.capitalize()}.mat", {name: array}, do_compression=True)
    rows = [f"{nm:.6f}\t9.780000\t0.920000\t0.5\t{i + 2}" for i, nm in enumerate(NM)]
    (folder / "92AV3C.spc").write_text("\n".join(["FILE x", "------", *rows]) + "\n")
    return folder


NM = np.linspace(400.02, 2498.96, 220).round(6)


@pytest.mark.parametrize(
    ("name", "bands"), [("indian-pines", 220), ("indian-pines-corrected", 200)]
)
def test_the_community_s_files(home: Path, name: str, bands: int) -> None:
    data = load_dataset(name)
    assert data.name == name
    assert data.image_shape == (256,)
    assert data.classes == indian_pines.CLASSES
    assert len(data.x_train) + len(data.x_test) == 16 * 29 * 29
    assert f"{bands} bands, padded with darkness to 256" in data.preprocessing
    assert "mapped from [955, 9604] to [0, 1]" in data.preprocessing
    assert not data.x_test[:, bands:].any()
    assert data.x_test[:, :bands].any(axis=0).all()
    assert data.wavelengths is not None
    assert np.isnan(data.wavelengths[bands:]).all()
    kept = NM if bands == 220 else np.delete(NM, indian_pines.WATER)
    assert data.wavelengths[:bands].tolist() == kept.tolist()
    scene = load_spectra(name)
    assert scene.cube.shape == (145, 145, bands)
    assert np.array_equal(
        load_dataset(name, split="blocks").x_test, scene.dataset("blocks", bands=256).x_test
    )
    assert download(name) == home
    assert all(result.ok for result in check(name))


def test_without_the_band_table_there_are_no_wavelengths(home: Path) -> None:
    (home / "92AV3C.spc").unlink()
    assert load_dataset("indian-pines").wavelengths is None
    with pytest.raises(InputError) as error:
        load_dataset("indian-pines-surrogate")
    one_line(error, "indian-pines-surrogate is not here", "92AV3C.spc and Indian_pines_gt.mat")


def test_the_corrected_bands_are_the_published_ones() -> None:
    given = [*range(104, 109), *range(150, 164), 220]  # counted from 1
    assert (indian_pines.WATER + 1).tolist() == given


def test_names_of_the_classes_agree() -> None:
    assert tuple(surrogate.CLASSES) == indian_pines.CLASSES


def test_what_is_missing_is_named(home: Path) -> None:
    (home / "Indian_pines.mat").unlink()
    with pytest.raises(InputError) as error:
        load_dataset("indian-pines")
    one_line(error, "Indian_pines.mat and Indian_pines_gt.mat", "indian_pines", "DEEPFSI_DATA")
    assert [result.ok for result in check("indian-pines")] == [False, True]
    where = {info.name: info.where for info in list_datasets()}
    assert where["indian-pines"] == "not here"
    assert where["indian-pines-corrected"] == str(home)


def test_files_of_something_else(home: Path) -> None:
    cases: list[tuple[str, Any, str]] = [
        ("Indian_pines.mat", {"indian_pines": np.ones((145, 145, 5))}, "5 bands, not 220"),
        ("Indian_pines.mat", {"salinas": np.ones((145, 145, 220))}, "variable indian_pines"),
        ("Indian_pines_gt.mat", {"indian_pines_gt": np.ones((145, 144))}, "(145, 144)"),
        ("Indian_pines_gt.mat", {"indian_pines_gt": np.eye(145) + 1}, "labels 0 to 16"),
    ]
    for file, content, part in cases:
        whole = (home / file).read_bytes()
        savemat(home / file, content)
        for name in ("indian-pines", "indian-pines-surrogate"):
            if name == "indian-pines-surrogate" and file == "Indian_pines.mat":
                continue
            with pytest.raises(InputError) as error:
                load_dataset(name)
            one_line(error, part if name == "indian-pines" else file)
            assert not all(result.ok for result in check(name))
        (home / file).write_bytes(whole)
    for content in ("FILE x\n---\n", "FILE x\n---\n400 9\n500 9\n", "FILE x\n---\nfour 9\n"):
        (home / "92AV3C.spc").write_text(content)
        with pytest.raises(InputError) as error:
            load_dataset("indian-pines")
        one_line(error, "92AV3C.spc", "replace it with the original")


# ---------------------------------------------------------------- the simulated scene


def test_the_simulated_scene_says_so_everywhere(home: Path) -> None:
    data = load_dataset("indian-pines-surrogate")
    assert data.name == "indian-pines-surrogate"
    assert "Simulated" in data.preprocessing
    assert "not the real scene" in data.preprocessing
    assert data.image_shape == (256,)
    assert load_spectra("indian-pines-surrogate").name == "indian-pines-surrogate"
    assert load_dataset("indian-pines").name != data.name


def test_the_simulated_scene_is_determined() -> None:
    labels = fields(40, 16)
    first, again, other = (surrogate.simulate(labels, NM, seed) for seed in (1, 1, 2))
    assert first.dtype == np.uint16
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


CROPS = ("Corn", "Soyb")
LIVE = np.r_[0:103, 108:149, 163:219]  # bands that the air lets through


@pytest.fixture(scope="module")
def scene() -> SpectralImage:
    """The simulated scene on the real label map."""
    return load_spectra("indian-pines-surrogate")


@real_labels
def test_counts_and_values(scene: SpectralImage) -> None:
    data = scene.dataset(bands=256)
    assert len(data.x_train) + len(data.x_test) == 10_249
    counts = np.bincount(np.r_[data.y_train, data.y_test])
    assert counts[[0, 8, 10]].tolist() == [46, 20, 2455]
    assert 900 < scene.cube.min() < 1000, "the published values begin at 955"
    assert 7000 < scene.cube.max() < 11_000, "and end at 9604"


def radiance(scene: SpectralImage, name: str, low: float, high: float) -> float:
    """Mean radiance above the offset, of a class between two wavelengths."""
    assert scene.wavelengths is not None
    bands = (scene.wavelengths > low) & (scene.wavelengths < high)
    label = indian_pines.CLASSES.index(name) + 1
    return float(scene.cube[scene.labels == label][:, bands].mean(dtype=float)) - 1000


@real_labels
def test_the_physics_shows(scene: SpectralImage) -> None:
    for name in indian_pines.CLASSES:
        for low, high in ((1370, 1400), (1860, 1900)):
            assert abs(radiance(scene, name, low, high)) < 20, "water vapour is opaque"
        assert radiance(scene, name, 930, 950) < 0.6 * radiance(scene, name, 860, 890)
    for name in ("Woods", "Grass-pasture", "Alfalfa"):
        red, green = (radiance(scene, name, *b) for b in ((660, 685), (545, 565)))
        infrared = radiance(scene, name, 780, 800)
        assert infrared > 2 * red, "the red edge"
        assert green > red
    soil = radiance(scene, "Soybean-clean", 780, 800) / radiance(scene, "Soybean-clean", 660, 685)
    assert soil < 2
    leaf_water = radiance(scene, "Woods", 1640, 1660) / radiance(scene, "Woods", 1070, 1080)
    dry = radiance(scene, "Soybean-clean", 1640, 1660) / radiance(
        scene, "Soybean-clean", 1070, 1080
    )
    assert leaf_water < dry


@real_labels
def test_neighbours_resemble_each_other(scene: SpectralImage) -> None:
    band = scene.cube[..., 40].astype(float)
    woods = scene.labels == 14
    inside = woods[:, :-1] & woods[:, 1:]
    left, right = band[:, :-1][inside], band[:, 1:][inside]
    assert np.corrcoef(left, right)[0, 1] > 0.5
    shuffled = np.random.default_rng(0).permutation(right)
    assert abs(np.corrcoef(left, shuffled)[0, 1]) < 0.1


@real_labels
def test_classes_are_as_hard_as_in_the_real_scene(scene: SpectralImage) -> None:
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
    from sklearn.metrics import confusion_matrix
    from sklearn.neighbors import KNeighborsClassifier

    def accuracy(model: Any, split: str, seed: int) -> float:
        data = scene.dataset(split, seed)
        x, x_test = data.x_train[:, LIVE], data.x_test[:, LIVE]
        return float((model.fit(x, data.y_train).predict(x_test) == data.y_test).mean())

    linear, nearest = LinearDiscriminantAnalysis(), KNeighborsClassifier(1)
    assert 0.7 < accuracy(linear, "random", 0) < 0.9
    random = accuracy(nearest, "random", 0)
    blocks = np.mean([accuracy(nearest, "blocks", seed) for seed in range(3)])
    assert random > blocks + 0.05, "neighbours leak"

    data = scene.dataset()
    guess = linear.fit(data.x_train[:, LIVE], data.y_train).predict(data.x_test[:, LIVE])
    wrong = confusion_matrix(data.y_test, guess)
    np.fill_diagonal(wrong, 0)
    crops = [indian_pines.CLASSES.index(c) for c in indian_pines.CLASSES if c[:4] in CROPS]
    assert wrong[np.ix_(crops, crops)].sum() > 0.5 * wrong.sum(), "corn and soybeans"
