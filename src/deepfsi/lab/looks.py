"""Looks of a folder of patterns: of masks that do not change, or of a design that makes them."""

from pathlib import Path

from deepfsi.base import require_torch
from deepfsi.hardware.live import FixedMaskLooks, LookChooser
from deepfsi.hardware.patterns import read_patterns


def open_looks(folder: Path) -> LookChooser:
    """Looks of a folder of patterns; only adaptive masks need torch.

    Parameters
    ----------
    folder : path
        Patterns of a design of several looks, or of the first of adaptive masks.

    Raises
    ------
    InputError
        If files are damaged, or the patterns are of fixed dwells.
    """
    looks = read_patterns(folder).manifest.looks
    if looks is None or not looks.adaptive:
        return FixedMaskLooks.read(folder)
    with require_torch():
        from deepfsi.lab.adaptive_looks import AdaptiveLooks
    return AdaptiveLooks.read(folder)
