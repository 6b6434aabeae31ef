"""Parts of a user's own, such as a classifier or a noise, named by where they are imported from.

A name is ``"module:name"``, as in ``"mylab.networks:Cnn"``. Importing runs the module's code, so
that only a name is imported that the user has given in a program, an option or a recipe, or one in
a design file that the user says to trust.
"""

import contextlib
import importlib
import importlib.util
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from deepfsi.base.errors import InputError

IMPORT_PATH = r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*"
"""Form of an import path."""

UNNAMED_PLUGIN = "own"
"""Name in settings of a part that is given as an object and has no import path."""


TORCH_MISSING = (
    'torch is not installed, and learning, testing and classifying need it: pip install "deepfsi'
    "[design]\"; a camera's computer needs none to show patterns and count"
)
"""Message where torch is missing."""

REPORT_MISSING = (
    'pages and figures need matplotlib and jinja2, which are not both installed: pip install "deepf'
    'si[report]"'
)
"""Message where what draws is missing."""

_REPORT_PACKAGES = ("jinja2", "markupsafe", "matplotlib")

_MISSING = {"torch": TORCH_MISSING, **dict.fromkeys(_REPORT_PACKAGES, REPORT_MISSING)}
"""Messages by the package that is missing."""


@contextlib.contextmanager
def require_extras() -> Iterator[None]:
    """Say in one line what to install where torch, or what draws, is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in _MISSING:
            raise
        raise InputError(_MISSING[error.name]) from None


def check_report() -> None:
    """Raise `InputError` where what draws pages and figures is missing, before any work."""
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
        found = importlib.import_module(module)
    except (Exception, SystemExit) as error:
        raise InputError(
            f"{path} cannot be imported, {type(error).__name__}: {error}; give module:name of an "
            "installed package or of a file in the current folder"
        ) from error
    for part in name.split("."):
        if not hasattr(found, part):
            raise InputError(f"{path} cannot be imported: {module} has no {name}")
        found = getattr(found, part)
    return found


def import_path(part: Any) -> str | None:
    """Where a part can be imported from again, or None, as for what a script itself defines."""
    module = getattr(part, "__module__", None)
    name = getattr(part, "__qualname__", None)
    if not module or not name or module == "__main__" or "<" in name:
        return None
    found = sys.modules.get(module)
    for step in name.split("."):
        found = getattr(found, step, None)
    return f"{module}:{name}" if found is part else None


def source_hash(path: str) -> str:
    """SHA-256 in hex of the file that defines a part, so that records of an older one expire."""
    import hashlib
    import inspect

    try:
        file = inspect.getsourcefile(load_plugin(path))
    except TypeError:
        file = None
    return hashlib.sha256(Path(file).read_bytes()).hexdigest() if file else ""
