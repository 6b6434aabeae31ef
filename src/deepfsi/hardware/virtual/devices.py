"""Virtual projector and photon counter: the virtual camera behind the two protocols of drivers.

The projector notes what the display shows whenever a pass starts; the counter writes, when it is
stopped, the photon file of these passes, as `record` would.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np

from deepfsi.errors import InputError
from deepfsi.hardware.patterns.folder import check_patterns, read_patterns
from deepfsi.hardware.virtual.camera import Camera, arrival_rates, write_photons
from deepfsi.progress import SILENT, Report


class VirtualProjector(AbstractContextManager["VirtualProjector"]):
    """Projector whose passes a `VirtualCounter` sees."""

    def __init__(self, display: Callable[[], np.ndarray]) -> None:
        self.display = display
        self.folder: Path | None = None
        self.passes: list[np.ndarray] = []

    def __exit__(self, *error: object) -> None:
        """Do nothing: there is nothing to close."""

    def load(self, folder: Path, report: Report = SILENT) -> None:
        """Check every frame of a pattern folder, as a real device must read them."""
        check_patterns(folder, report)
        self.folder = folder

    def run(self) -> None:
        """Note the scene; a virtual pass takes no time."""
        if self.folder is None:
            raise InputError("no patterns are loaded: load a pattern folder first")
        self.passes.append(np.array(self.display()))

    def wait(self) -> None:
        """Return: a virtual pass has ended."""

    def halt(self) -> None:
        """Do nothing: a virtual pass has ended."""


class VirtualCounter(AbstractContextManager["VirtualCounter"]):
    """Counter of the photons of a virtual projector's passes."""

    def __init__(
        self, projector: VirtualProjector, camera: Camera, flux: float, seed: int = 0
    ) -> None:
        self.projector, self.camera, self.flux = projector, camera, flux
        self._rng = np.random.default_rng(seed)
        self._path: Path | None = None
        self._first = 0

    def __exit__(self, *error: object) -> None:
        """Forget a recording that was not stopped: no file is begun before."""
        self._path = None

    def start(self, path: Path) -> None:
        """Begin with the next pass."""
        self._path, self._first = path, len(self.projector.passes)

    def stop(self) -> None:
        """Write the file.

        Raises `InputError` if nothing was started, or no pass has run since.
        """
        path, self._path = self._path, None
        scenes = self.projector.passes[self._first :]
        if path is None or self.projector.folder is None or not scenes:
            raise InputError("nothing is recorded: start the counter, then run a pass")
        manifest = read_patterns(self.projector.folder).manifest
        flow = arrival_rates(self.projector.folder, np.stack(scenes), self.camera, self.flux)
        write_photons(path, manifest, flow, self.camera, self._rng)
