"""Data sets of named sources, folders of images, hyperspectral cubes and arrays.

A `Dataset` holds scenes as reflectance in [0, 1], one row each, with integer labels, already
divided into a training and a test part. Where the source has no test part of its own, a seeded
stratified fifth of it is set aside. The training scenes are always in random order, so that the
last of them are a fair sample to validate on (`Dataset.hold_out`).
"""

from deepfsi.datasets.arrays import as_test_part, from_arrays
from deepfsi.datasets.catalog import (
    DIM_BLACK,
    check,
    download,
    list_datasets,
    load_indian_pines,
)
from deepfsi.datasets.dataset import Dataset, MeasureTitle, Origin
from deepfsi.datasets.decoding import PICTURE_FORMATS, check_grey_levels, is_deep, unread_kind
from deepfsi.datasets.display import (
    Display,
    array_display,
    read_display,
    read_scene_list,
    write_display,
    write_pictures,
)
from deepfsi.datasets.levels import StoredScenes, is_stored
from deepfsi.datasets.load import (
    Source,
    absolute_source,
    as_dataset,
    check_source,
    load_dataset,
    options_of,
    prepare_display,
)
from deepfsi.datasets.readouts import MeasuredReadouts, Variables, read_readouts
from deepfsi.datasets.spectra import SpectralImage
from deepfsi.datasets.store import cache_folder, fetch
from deepfsi.datasets.variants import ambient, jitter

__all__ = [
    "DIM_BLACK",
    "PICTURE_FORMATS",
    "Dataset",
    "Display",
    "MeasureTitle",
    "MeasuredReadouts",
    "Origin",
    "Source",
    "SpectralImage",
    "StoredScenes",
    "Variables",
    "absolute_source",
    "ambient",
    "array_display",
    "as_dataset",
    "as_test_part",
    "cache_folder",
    "check",
    "check_grey_levels",
    "check_source",
    "download",
    "fetch",
    "from_arrays",
    "is_deep",
    "is_stored",
    "jitter",
    "list_datasets",
    "load_dataset",
    "load_indian_pines",
    "options_of",
    "prepare_display",
    "read_display",
    "read_readouts",
    "read_scene_list",
    "unread_kind",
    "write_display",
    "write_pictures",
]
