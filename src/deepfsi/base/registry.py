"""Parts that packages beside the core provide, and parts of a user's own.

Packages beside the core are found by their entry points of group ``deepfsi``. A user's own part,
such as a classifier or a noise, is named by where it is imported from: ``"module:name"``, as in
``"mylab.networks:Cnn"``. Importing runs the module's code. A name is therefore imported only if the
user gave it in a program, an option or a recipe, or trusts the design file that holds it.
"""

import contextlib
import importlib
import importlib.util
import os
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from deepfsi.base.errors import InputError, as_input_error, check_choice
from deepfsi.base.files import hash_file

IMPORT_PATH = r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*"
"""Form of an import path."""

UNNAMED_PLUGIN = "own"
"""Name in settings of a part that is given as an object and has no import path."""


TORCH_MISSING = (
    "torch is not installed, and learning, testing and classifying need it: "
    'pip install "deepfsi[design]"; a camera\'s computer needs none to show patterns and count'
)
REPORT_MISSING = (
    "pages and figures need matplotlib and jinja2, which are not both installed: "
    'pip install "deepfsi[report]"'
)
_REPORT_PACKAGES = ("jinja2", "markupsafe", "matplotlib")
_MISSING = {"torch": TORCH_MISSING, **dict.fromkeys(_REPORT_PACKAGES, REPORT_MISSING)}


@contextlib.contextmanager
def require_extras() -> Iterator[None]:
    """Turn the error of a missing optional package into advice on what to install."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in _MISSING:
            raise
        raise InputError(_MISSING[error.name]) from None


def check_report() -> None:
    """Raise `InputError` before any work if a package that draws pages is missing."""
    with require_extras():
        for name in _REPORT_PACKAGES:
            if importlib.util.find_spec(name) is None:
                raise ModuleNotFoundError(name=name)


def load_plugin(path: str) -> Any:
    """Import a part from an installed package, or from a file in the current folder."""
    module, _, name = path.partition(":")
    if (here := os.getcwd()) not in sys.path:
        sys.path.append(here)  # as for `python -m`; the command's own folder is there instead
    try:
        target = importlib.import_module(module)
        for step in name.split("."):
            target = getattr(target, step)
    except (Exception, SystemExit) as error:  # a script may end itself where it is imported
        raise InputError(
            f"{path} cannot be imported, {type(error).__name__}: {error}; give module:name of an "
            "installed package or of a file in the current folder"
        ) from error
    return target


def import_path(part: Any) -> str | None:
    """Import path of a part; None if a script or a function defines it."""
    module = getattr(part, "__module__", None)
    name = getattr(part, "__qualname__", None)
    if not module or not name or module == "__main__" or "<" in name:
        return None
    target = sys.modules.get(module)
    for step in name.split("."):
        target = getattr(target, step, None)
    return f"{module}:{name}" if target is part else None  # another may have taken the name


def source_hash(path: str) -> str:
    """SHA-256 in hex of the file that defines a part: records of an older one expire by it."""
    import inspect

    try:
        file = inspect.getsourcefile(load_plugin(path))
    except TypeError:  # an instance, or a part of a compiled module
        file = None
    return hash_file(Path(file)) if file else ""


class Registry:
    """Parts by their names, each with its import path: it is loaded when it is used."""

    def __init__(self) -> None:
        # Import paths by kind and name. A projector shows passes of all frames, a list projector
        # frames that are chosen meanwhile; adaptive masks go by the noise of their detectors
        self.parts: dict[str, dict[str, str]] = {
            "projector": {},  # a `PassProjector`
            "list projector": {},  # a `StreamingProjector`
            "counter": {},  # a `StreamingCounter`
            "classifier": {},  # its `ClassifierFacts`
            "adaptive": {},  # its `AdaptiveTraining`
        }
        # By the kind of their entries: the settings that ask for an exposure, and its class
        self.schemes: dict[str, tuple[tuple[str, ...], str]] = {}
        # By their words, such as "camera transits": import path and summary
        self.commands: dict[str, tuple[str, str]] = {}

    def add_scheme(self, kind: str, settings: tuple[str, ...], target: str) -> None:
        """Add a kind of exposure: the settings that ask for it, and their class, an `Exposure`."""
        self.schemes[kind] = settings, target

    def add_part(self, kind: str, name: str, target: str) -> None:
        """Add a part; of a device a class or function whose keywords are its settings."""
        self.parts[kind][name] = target

    def add_command(self, words: str, target: str, summary: str) -> None:
        """Add a command of `deepfsi`, or of one of its groups: a `Command`."""
        self.commands[words] = target, summary

    def open_device(self, role: str, text: str, **wiring: Any) -> Any:
        """Driver of a device by ``NAME[,SETTING=VALUE...]``, not yet taken hold of."""
        name, *settings = text.split(",")
        check_choice(role, name, self.parts[role])
        with as_input_error():
            return load_plugin(self.parts[role][name])(
                **wiring, **dict(setting.partition("=")[::2] for setting in settings)
            )


@cache
def installed() -> Registry:
    """Parts of all installed packages."""
    from importlib.metadata import entry_points

    registry = Registry()
    for point in entry_points(group="deepfsi"):
        if importlib.util.find_spec(point.module.partition(".")[0]):
            point.load()(registry)
    return registry
