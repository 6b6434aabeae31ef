"""Data sets of named sources, folders of images, hyperspectral cubes and arrays.

A `Dataset` holds scenes as reflectance in [0, 1], one row each, with integer labels, already
divided into a training and a test part. Where the source has no test part of its own, a seeded
stratified fifth of it is set aside. The training scenes are always in random order, so that the
last of them are a fair sample to validate on (`Dataset.hold_out`).
"""

from deepfsi.datasets.arrays import as_test_part, from_arrays
from deepfsi.datasets.catalog import check, download, list_datasets
from deepfsi.datasets.conditions import ambient, jitter
from deepfsi.datasets.dataset import Dataset, Origin
from deepfsi.datasets.display import array_display, read_display, write_display, write_pictures
from deepfsi.datasets.load import (
    Source,
    absolute,
    as_dataset,
    check_source,
    load_dataset,
    prepared,
    takes,
)
from deepfsi.datasets.spectra import SpectralImage
from deepfsi.datasets.values import StoredScenes, is_stored

__all__ = [
    "Dataset",
    "Origin",
    "Source",
    "SpectralImage",
    "StoredScenes",
    "absolute",
    "ambient",
    "array_display",
    "as_dataset",
    "as_test_part",
    "check",
    "check_source",
    "download",
    "from_arrays",
    "is_stored",
    "jitter",
    "list_datasets",
    "load_dataset",
    "prepared",
    "read_display",
    "takes",
    "write_display",
    "write_pictures",
]
