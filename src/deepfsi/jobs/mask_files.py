"""A user's own masks: an array or a MATLAB variable becomes a sensing matrix."""

import numpy as np

from deepfsi.base.arrays import read_array, split_variable
from deepfsi.base.errors import InputError


def read_matrix(source: str) -> np.ndarray:
    """Read masks (m, N) from a file."""
    path, variable = split_variable(source)
    ways = (
        "a .npy file, or a .mat file with one numeric variable (or FILE:VARIABLE), of shape "
        "(m, N) or (m, H, W)"
    )
    if not path.exists():
        raise InputError(f"no matrix at {path}: give {ways}")
    # A small file may claim more than memory holds
    masks = read_array(path, (2, 3), variable)
    if masks.ndim not in (2, 3) or not masks.size:
        raise InputError(f"{path} holds an array of shape {masks.shape}: give {ways}")
    if masks.dtype.kind in "bu" and masks.dtype.itemsize <= 2:  # levels, the last of all light
        full = 1 if masks.max() <= 1 else int(np.iinfo(masks.dtype).max)
        masks = masks / (full * len(masks))
    return masks.reshape(len(masks), -1)
