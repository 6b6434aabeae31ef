"""Indian Pines: the real scene where its files are at hand, and a simulated one that says so.

M. F. Baumgardner, L. L. Biehl, D. A. Landgrebe, "220 Band AVIRIS Hyperspectral Image Data Set: June
12, 1992 Indian Pine Test Site 3", Purdue University Research Repository, 2015,
doi:10.4231/R7RX991C; as the ``.mat`` files of the Grupo de Inteligencia Computacional, UPV/EHU. The
public file has 220 bands of AVIRIS's 224, the corrected one 200: it lacks those that water vapour
takes. Both are padded with darkness to 256, as the paper pads the 224 that it counts.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from deepfsi.datasets.cubes import read_cube, read_labels
from deepfsi.datasets.spectra import SpectralImage
from deepfsi.datasets.store import FileCheck, candidates, find_folder
from deepfsi.errors import InputError

FOLDER = "indian_pines"
LABELS_FILE = "Indian_pines_gt.mat"
BANDS_FILE = "92AV3C.spc"
SURROGATE = "indian-pines-surrogate"

BANDS = 256
"""Bands after padding."""

SIDE = 145
"""Height and width of the scene, pixels."""

SCENE_SEED = 1992
"""Seed of the surrogate: one scene, whatever the seed of its split."""

WATER = np.r_[103:108, 149:163, 219]
"""Bands, counted from 0, that the corrected file lacks."""

CLASSES = (
    *("Alfalfa", "Corn-notill", "Corn-mintill", "Corn"),
    *("Grass-pasture", "Grass-trees", "Grass-pasture-mowed", "Hay-windrowed", "Oats"),
    *("Soybean-notill", "Soybean-mintill", "Soybean-clean"),
    *("Wheat", "Woods", "Buildings-Grass-Trees-Drives", "Stone-Steel-Towers"),
)
"""Names of the classes 1 to 16."""


SOURCES = {
    "indian-pines": ("Indian_pines.mat", 220),
    "indian-pines-corrected": ("Indian_pines_corrected.mat", 200),
    SURROGATE: (BANDS_FILE, 220),
}
"""File that a name needs beside the labels, and the number of its bands."""


def load_scene(name: str) -> SpectralImage:
    """Whole image, the real one or the simulated one, for maps and overviews."""
    folder = download(name)
    if name == SURROGATE:
        return _simulated(folder)
    file, bands = SOURCES[name]
    scene = read_cube(
        folder / file,
        folder / LABELS_FILE,
        variables=(Path(file).stem.lower(), "indian_pines_gt"),
        name=name,
        classes=CLASSES,
        origin="Radiance as published,",
    )
    _check_labels(scene.labels, folder)
    if scene.cube.shape[2] != bands:
        raise InputError(
            f"{folder / file} has {scene.cube.shape[2]} bands, not {bands}; "
            "replace it with the original"
        )
    if not (folder / BANDS_FILE).is_file():
        return scene
    wavelengths = _wavelengths(folder / BANDS_FILE)
    return replace(
        scene, wavelengths=np.delete(wavelengths, WATER) if bands == 200 else wavelengths
    )


def _simulated(folder: Path) -> SpectralImage:
    from deepfsi.datasets.surrogate import simulate

    labels = read_labels(folder / LABELS_FILE, "indian_pines_gt")
    _check_labels(labels, folder)
    wavelengths = _wavelengths(folder / BANDS_FILE)
    cube = simulate(labels, wavelengths, SCENE_SEED)
    origin = "Simulated radiance on the label map of Indian Pines, not the real scene,"
    return SpectralImage(SURROGATE, cube, labels, CLASSES, wavelengths, origin)


def _check_labels(labels: npt.NDArray[np.integer], folder: Path) -> None:
    if labels.shape != (SIDE, SIDE) or set(np.unique(labels).tolist()) != set(range(17)):
        raise InputError(
            f"{folder / LABELS_FILE} is no map of {SIDE}x{SIDE} pixels with the labels 0 to 16; "
            "replace it with the original"
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


def where(name: str) -> Path | None:
    """First folder that has all files of a name."""
    return find_folder(FOLDER, (SOURCES[name][0], LABELS_FILE))


def download(name: str) -> Path:
    """Folder of the files; they are not to be downloaded."""
    folder = where(name)
    if folder is None:
        raise InputError(
            f"{name} is not here, and not downloaded: put {SOURCES[name][0]} and {LABELS_FILE} "
            f"into a folder {FOLDER}, and set DEEPFSI_DATA to the folder that holds it (the .mat "
            "files are on UPV/EHU's page 'Hyperspectral Remote Sensing Scenes')"
        )
    return folder


def check(name: str) -> list[FileCheck]:
    """Say of each file whether it is there, and of the scene whether it can be loaded."""
    files = (SOURCES[name][0], LABELS_FILE)
    if where(name) is None:
        home = candidates(FOLDER)[0]
        return [FileCheck(file, (home / file).is_file(), f"looked for in {home}") for file in files]
    try:
        load_scene(name)
    except InputError as error:
        return [FileCheck(name, False, str(error))]
    return [FileCheck(file, True, "as expected; no hash is known") for file in files]
