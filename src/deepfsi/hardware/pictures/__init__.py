"""Pictures from counts, without a design, and a test of the light behind masks and inverses."""

from deepfsi.hardware.pictures.rail_sums import (
    Excess,
    RailSums,
    check_rail_sums,
    fineness,
    split_rails,
)
from deepfsi.hardware.pictures.solve import (
    coarse_light,
    reconstruct,
    solve_masks,
    solve_wavelets,
    split_levels,
    wavelet_of,
)

__all__ = [
    "Excess",
    "RailSums",
    "check_rail_sums",
    "coarse_light",
    "fineness",
    "reconstruct",
    "solve_masks",
    "solve_wavelets",
    "split_levels",
    "split_rails",
    "wavelet_of",
]
