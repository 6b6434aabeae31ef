"""Ways of drivers to say what a device refused, and to let go of it."""

import contextlib
from collections.abc import Callable, Iterator

from deepfsi.base.errors import InputError


@contextlib.contextmanager
def refusals(
    device: str, doing: str, *, reason: Callable[[Exception], str | None]
) -> Iterator[None]:
    """Say in one line what a device refused; `reason` is None for what is no refusal of it."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        said = reason(error)
        if said is None:
            raise
        raise InputError(
            f"{device} cannot {doing}: {said.rstrip('.')}; check that it is on, connected and not "
            "used by another program"
        ) from error


def let_go(
    kind: type[BaseException] | None, halt: Callable[[], None], close: Callable[[], None]
) -> None:
    """Halt and close a device; what went wrong before goes before what goes wrong here."""
    quiet = contextlib.suppress(InputError) if kind else contextlib.nullcontext()
    with quiet, contextlib.ExitStack() as stack:
        stack.callback(close)
        halt()
