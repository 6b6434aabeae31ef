"""Shared by drivers: import a maker's library, report refusals, let go of a device."""

import contextlib
import importlib
from collections.abc import Callable, Iterator
from typing import Any

from deepfsi.base.errors import InputError


def import_library(device: str, package: str, *modules: str) -> Any:
    """First installed module of a maker's library; pip installs it as `package`."""
    for module in modules:
        try:
            return importlib.import_module(module)
        except ModuleNotFoundError:
            continue
        except (ImportError, OSError) as error:  # the library under the module is not found
            raise InputError(f"{device} cannot be used: {error}; install its software") from None
    raise InputError(f"{device} needs {package}, which is not installed: pip install {package}")


@contextlib.contextmanager
def refusals(
    device: str, doing: str, *, reason: Callable[[Exception], str | None]
) -> Iterator[None]:
    """Raise refusals of a device in one line; `reason` is None for other errors."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        text = reason(error)
        if text is None:
            raise
        raise InputError(
            f"{device} cannot {doing}: {text.rstrip('.')}; check that it is on, connected and not "
            "used by another program"
        ) from error


def let_go(
    kind: type[BaseException] | None, halt: Callable[[], None], close: Callable[[], None]
) -> None:
    """Halt and close a device; an earlier error hides errors of this."""
    quiet = contextlib.suppress(InputError) if kind else contextlib.nullcontext()
    with quiet, contextlib.ExitStack() as stack:
        stack.callback(close)
        halt()
