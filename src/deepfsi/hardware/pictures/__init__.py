"""Pictures from counts, without a design, and a test of the light behind masks and inverses."""

from deepfsi.hardware.pictures.rail_sums import Excess, RailSums
from deepfsi.hardware.pictures.solve import reconstruct
from deepfsi.hardware.pictures.tables import (
    TableMasks,
    TablePictures,
    compare_picture,
    read_pictures,
)

__all__ = [
    "Excess",
    "RailSums",
    "TableMasks",
    "TablePictures",
    "compare_picture",
    "read_pictures",
    "reconstruct",
]
