"""Pictures from counts, without a design, and a test of the light behind masks and inverses."""

from deepfsi.hardware.pictures.solve import reconstruct
from deepfsi.hardware.pictures.tables import (
    TableMasks,
    compare_picture,
    read_pictures,
)

__all__ = [
    "TableMasks",
    "compare_picture",
    "read_pictures",
    "reconstruct",
]
