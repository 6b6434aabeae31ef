"""Design files that come with the package, opened by their names. No torch."""

import os
import re
from importlib.resources import files
from pathlib import Path

from deepfsi.base.errors import InputError, closest_choice

SHIPPED_DESIGNS = Path(str(files(__package__) / "shipped"))
"""Their folder."""


def find_design(given: str | os.PathLike[str]) -> Path:
    """Path of a design file: the one that was given, or that of a published design by its name.

    A name has no ending and no separator, and nothing is at that path.
    """
    name = os.fspath(given)
    path = Path(given)
    if path.exists():
        return path
    if path.name and (longer := path.with_name(f"{path.name}.safetensors")).is_file():
        raise InputError(f"no design file at {name}: did you mean {longer}?")
    if not re.fullmatch("[A-Za-z0-9_-]+", name):
        return path
    names = sorted(file.stem for file in SHIPPED_DESIGNS.iterdir())
    if name not in names:
        raise InputError(
            f"no design file and no published design {name!r}: {closest_choice(name, names)}; "
            "make a file with `deepfsi design`"
        )
    return SHIPPED_DESIGNS / f"{name}.safetensors"
