"""Rails and looks of a design, of masks that do not change or of a design that makes them."""

import os
from pathlib import Path

from deepfsi.base import read_regular, require_extras
from deepfsi.base.numeric import LARGEST_TENSORS
from deepfsi.designfile import AdaptiveHeader, DesignFile
from deepfsi.hardware.live import FixedMaskLooks, LookChooser
from deepfsi.hardware.patterns import DesignRails, read_patterns


def design_rails(file: str | os.PathLike[str]) -> DesignRails:
    """Rails of a design file, as `export_patterns` takes them; only adaptive masks need torch."""
    path = Path(file)
    if isinstance(DesignFile.read(path, ()).header, AdaptiveHeader):
        with require_extras():
            from deepfsi.lab.adaptive_looks import adaptive_rails
        return adaptive_rails(path)
    return DesignRails.of(
        DesignFile.read(path), read_regular(path, LARGEST_TENSORS, "give a design file")
    )


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
    patterns = read_patterns(folder)
    looks = patterns.manifest.looks
    if looks is None or not looks.adaptive:
        return FixedMaskLooks.read(folder, patterns)
    with require_extras():
        from deepfsi.lab.adaptive_looks import AdaptiveLooks
    return AdaptiveLooks.read(folder, patterns.manifest)
