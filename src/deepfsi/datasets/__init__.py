"""Data sets: a name, a folder of images, a cube, an ``.npz`` file or arrays become one `Dataset`.

A `Dataset` holds scenes as reflectance in [0, 1], one row each, with integer labels, already
divided into a training and a test part. Where the source has no test part of its own, a seeded
stratified fifth of it is set aside. The training scenes are always in random order, so that the
last of them are a fair sample to validate on (`Dataset.hold_out`).
"""

from deepfsi.datasets.arrays import from_arrays
from deepfsi.datasets.catalog import DatasetInfo, check, download, list_datasets
from deepfsi.datasets.cubes import read_cube
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.display import Display, read_display, write_display, write_pictures
from deepfsi.datasets.load import load_dataset, load_spectra
from deepfsi.datasets.spectra import SpectralImage
from deepfsi.datasets.store import FileCheck

__all__ = [
    "Dataset",
    "DatasetInfo",
    "Display",
    "FileCheck",
    "SpectralImage",
    "check",
    "download",
    "from_arrays",
    "list_datasets",
    "load_dataset",
    "load_spectra",
    "read_cube",
    "read_display",
    "write_display",
    "write_pictures",
]
