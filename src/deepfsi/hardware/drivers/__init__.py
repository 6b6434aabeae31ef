"""What shows patterns and what counts photons, so that a laboratory can bring its own.

Both are context managers that let go of their device on every way out, Ctrl-C included. A lab
whose counter has its own software needs a `PatternProjector` only: its PTU file and the pattern
folder are all that `hardware.acquisition` reads.
"""

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

__all__ = ["PatternProjector", "PhotonCounter"]

Progress = Callable[[float], None]


class PatternProjector(Protocol):
    """A micromirror device that shows a folder of patterns, and marks the start of each frame."""

    def __enter__(self) -> Self:
        """Take hold of the device."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop showing and let go of the device."""

    def load(self, folder: Path, progress: Progress | None = None) -> None:
        """Bring the frames of a pattern folder into the device, in place of earlier ones."""

    def run(self) -> None:
        """Start one pass over all frames; it may end after this returns."""

    def wait(self) -> None:
        """Return when the pass has ended."""

    def halt(self) -> None:
        """Stop the pass where it is."""


class PhotonCounter(Protocol):
    """Photon-counting electronics that record photons and frame markers into a PTU file."""

    def __enter__(self) -> Self:
        """Take hold of the device."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop recording and let go of the device; a file that was not finished is removed."""

    def start(self, path: Path) -> None:
        """Begin to record into a new file."""

    def stop(self) -> None:
        """End the recording; its file is then whole."""
