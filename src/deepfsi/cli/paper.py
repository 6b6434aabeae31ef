"""The paper's experiments: a package of their own, beside this one, which works without it."""

from collections.abc import Iterable
from importlib import import_module
from importlib.resources import files
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING

from deepfsi.base import InputError

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

PACKAGE = "deepfsi_paper"


def installed() -> bool:
    """True where the experiments are."""
    return find_spec(PACKAGE) is not None


def recipes() -> "Iterable[Traversable]":
    """Recipes of the experiments; none where these are missing."""
    return (files(PACKAGE) / "recipes").iterdir() if installed() else ()


def studies() -> ModuleType:
    """The experiments by name, or `InputError` where they are missing."""
    if not installed():
        raise InputError(
            f"the paper's experiments are missing: {PACKAGE}, which comes with deepfsi, is not "
            "installed; install deepfsi again"
        )
    return import_module(f"{PACKAGE}.studies")
