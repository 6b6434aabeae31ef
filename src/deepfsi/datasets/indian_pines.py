"""Indian Pines: the scene of the AVIRIS spectrometer, without the bands that water vapour takes.

M. F. Baumgardner, L. L. Biehl, D. A. Landgrebe, "220 Band AVIRIS Hyperspectral Image Data Set: June
12, 1992 Indian Pine Test Site 3", Purdue University Research Repository, 2015,
doi:10.4231/R7RX991C. The corrected cube of the Grupo de Inteligencia Computacional, UPV/EHU, has
200 of its 220 bands; the paper counts AVIRIS's 224. The cube is padded with darkness to 256 bands,
as the paper pads its own.

The Python package ``tensorly`` (BSD 3-Clause) contains the cube and its label map. Its bytes were
once transferred as a text: every byte 13, a carriage return, became 10, a line feed. None of the
8.4 million bytes is 13. Other copies of the scene may have the same origin. A high byte that
changed took 768 from a value; `restored` gives it back.
"""

import hashlib
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from deepfsi.base import InputError
from deepfsi.datasets.cubes import read_cube
from deepfsi.datasets.spectra import SpectralImage
from deepfsi.datasets.store import FileCheck, candidates

NAME = "indian-pines"

FOLDER = "indian_pines"
"""Its folder in ``$DEEPFSI_DATA``."""

PACKAGE = ("tensorly", "datasets/data")
"""Installed package that contains the files, and their folder in it."""

CUBE, LABELS = "Indian_pines_corrected", "Indian_pines_gt"
"""Names of the files, each with the ending .npy or .mat."""

CARRIAGE_RETURN, LINE_FEED = 13, 10

HASHES = {
    CUBE: "36468dd7336c8bd37a80cced54362ea426f226703f3797ba494556fd8134e77f",
    LABELS: "ebf20cfe0bce98f01885f0ab4fd1857925db3ef0a1f1624bbee3ffcb92425103",
}
"""SHA-256 of the values, whatever the file: row by row, of 16 bits the lower byte first, labels 8.

Writers of ``.mat`` files pack the same values into other bytes. Bytes 13 of the cube count as 10,
so that a copy that lost them and one that did not have one hash.
"""

RANK, FITTED, SOFT, PASSES = 20, 4, 4, 12
"""Of `restored`: components, one pixel in so many, passes before values are chosen, and all."""

BANDS_FILE = "92AV3C.spc"
"""Band table, which gives the wavelengths where it lies beside the cube."""

BANDS = 256
"""Bands after padding."""

WATER = np.r_[103:108, 149:163, 219]
"""Bands of the 220, counted from 0, that the corrected cube lacks."""

CLASSES = (
    *("Alfalfa", "Corn-notill", "Corn-mintill", "Corn"),
    *("Grass-pasture", "Grass-trees", "Grass-pasture-mowed", "Hay-windrowed", "Oats"),
    *("Soybean-notill", "Soybean-mintill", "Soybean-clean"),
    *("Wheat", "Woods", "Buildings-Grass-Trees-Drives", "Stone-Steel-Towers"),
)
"""Names of the classes 1 to 16."""


class SceneFiles(NamedTuple):
    """Files of the cube and of its label map, in one folder."""

    cube: Path
    labels: Path


def load_scene() -> SpectralImage:
    """Whole image, for maps and overviews.

    Raises
    ------
    InputError
        If its files are missing, cannot be read, or hold other values.
    """
    scene_files = _files()
    scene = _read(scene_files)
    for path, array in zip(scene_files, (scene.cube, scene.labels), strict=True):
        if values_hash(array) != HASHES[path.stem]:
            raise InputError(
                f"{path} does not hold the values of Indian Pines; replace it with the original, "
                "or give the path of a cube of your own"
            )
    if not (high_bytes(scene.cube) == CARRIAGE_RETURN).any():
        words = f"{scene.origin} with its lost bytes restored,"
        scene = replace(scene, cube=restored(scene.cube.astype(np.uint16)), origin=words)
    table = scene_files.cube.parent / BANDS_FILE
    if not table.is_file():
        return scene
    return replace(scene, wavelengths=np.delete(_wavelengths(table), WATER))


def high_bytes(cube: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    """High bytes of values of 16 bits."""
    return cube.astype(np.uint16) >> 8


def values_hash(values: npt.NDArray[np.generic]) -> str:
    """SHA-256 of whole numbers, as `HASHES` has it."""
    kind = "<u2" if values.ndim == 3 else "u1"
    if values.dtype.kind not in "ui" or (values != values.astype(kind)).any():
        return "other values"
    content = values.astype(kind).tobytes()
    if values.ndim == 3:
        content = content.replace(bytes([CARRIAGE_RETURN]), bytes([LINE_FEED]))
    return hashlib.sha256(content).hexdigest()


def restored(cube: npt.NDArray[np.uint16], low: int = LINE_FEED) -> npt.NDArray[np.uint16]:
    """The cube (H, W, B) with the high bytes 13 that became 10.

    Parameters
    ----------
    cube : array of uint16, shape (H, W, B)
    low : int
        High byte that stands for itself and for the one above it by 3.

    Notes
    -----
    Spectra of a scene are nearly combinations of a few. Each band is predicted from the components
    of all other bands, fitted to pixels whose value is sure; of the two values that a byte may
    stand for, 768 apart, the nearer one is taken. On other pairs of bytes, which are not damaged
    and were made so, one value in 1300 to 22 000 is chosen wrongly, nearly all of them in the first
    band. A low byte that changed is wrong by 3, a tenth of the noise, and stays.
    """
    lower = cube.reshape(-1, cube.shape[2]).astype(float)
    unsure = high_bytes(cube).reshape(lower.shape) == low
    gap = 256.0 * (CARRIAGE_RETURN - LINE_FEED)
    fitted = np.arange(len(lower)) % FITTED == 0
    values = np.where(unsure, 0.0, lower)
    values = np.where(unsure, values.sum(axis=0) / np.maximum((~unsure).sum(axis=0), 1), lower)
    for number in range(PASSES):
        scaled = (values - values.mean(axis=0)) / np.maximum(values.std(axis=0), 1.0)
        axes = np.linalg.eigh(scaled.T @ scaled)[1][:, -RANK:]
        scores = scaled @ axes
        for band in np.flatnonzero(unsure.any(axis=0)):
            others = np.c_[scores - scaled[:, band, None] * axes[band], np.ones(len(lower))]
            sure, asked = fitted & ~unsure[:, band], unsure[:, band]
            weights = np.linalg.lstsq(others[sure], lower[sure, band], rcond=None)[0]
            expected, either = others[asked] @ weights, lower[asked, band]
            nearer = abs(either + gap - expected) < abs(either - expected)
            values[asked, band] = expected if number < SOFT else either + gap * nearer
    return values.reshape(cube.shape).astype(np.uint16)


def _read(scene_files: SceneFiles) -> SpectralImage:
    return read_cube(
        *scene_files,
        variables=(CUBE.lower(), LABELS.lower()),
        name=NAME,
        classes=CLASSES,
        origin="Radiance as published, 200 of 220 bands,",
    )


def _wavelengths(path: Path) -> npt.NDArray[np.float64]:
    """Band centres in nm from the band table, in the order of the bands: not quite rising."""
    try:
        rows = [line.split() for line in path.read_text("utf-8").splitlines()[2:] if line.strip()]
        table = np.array([float(row[0]) for row in rows])
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot read the band table {path} ({error}); replace it with the original"
        ) from error
    if table.shape != (220,) or not (table > 0).all():
        raise InputError(f"{path} does not list 220 wavelengths; replace it with the original")
    return table


def where(name: str = NAME) -> Path | None:
    """First folder that has the cube and its label map: of data sets, or of `PACKAGE`."""
    scene_files = _find()
    return scene_files.cube.parent if scene_files else None


def download(name: str = NAME) -> Path:
    """Folder of the files; they are not to be downloaded."""
    return _files().cube.parent


def _files() -> SceneFiles:
    if scene_files := _find():
        return scene_files
    raise InputError(
        f"{NAME} is not here: pip install {PACKAGE[0]}, which contains it; or put {CUBE}.mat and "
        f"{LABELS}.mat into a folder {FOLDER}, and set DEEPFSI_DATA to the folder that holds it"
    )


def _find() -> SceneFiles | None:
    """Both files, of the first folder that has them."""
    spec = find_spec(PACKAGE[0])
    installed = list(spec.submodule_search_locations or ()) if spec else []
    for folder in [*candidates(FOLDER), *(Path(each) / PACKAGE[1] for each in installed)]:
        cube, labels = (
            next((p for end in (".npy", ".mat") if (p := folder / f"{stem}{end}").is_file()), None)
            for stem in (CUBE, LABELS)
        )
        if cube and labels:
            return SceneFiles(cube, labels)
    return None


def check(name: str = NAME) -> list[FileCheck]:
    """Say of each file whether it is there, and whether it holds the values of the original."""
    scene_files = _find()
    if scene_files is None:
        home = candidates(FOLDER)[0]
        return [FileCheck(f"{stem}.mat", False, f"looked for in {home}") for stem in HASHES]
    try:
        scene = _read(scene_files)
    except InputError as error:
        return [FileCheck(NAME, False, str(error))]
    pairs = zip(scene_files, (scene.cube, scene.labels), strict=True)
    return [_file_check(path, values_hash(array)) for path, array in pairs]


def _file_check(path: Path, found_hash: str) -> FileCheck:
    expected = HASHES[path.stem]
    if found_hash == expected:
        return FileCheck(path.name, True, "sha256 of its values agrees, bytes 13 read as 10")
    return FileCheck(path.name, False, f"sha256 of its values is {found_hash}, not {expected}")
