"""Virtual camera: scenes on a monitor to a photon file, as the laboratory would write it.

    scene -> perspective -> blur -> vignetting -> mirrors -> detectors (`detector`) -> file

Places are (across, down) in two unit squares: the displayed image, and the area of the device that
the cells of a mask fill. A display has a fixed brightness: a mirror that sees it gets as much light
if the image is larger or shifted. A stop hides the mirrors beyond the cells. One arm sees the
mirrors that are ON; a second arm sees those that are OFF.

It shares no code with `physics.noise` and the scanner, so that each checks the other: with the
ideal camera a gate's counts are Poisson, with the scanner's mean.
"""

import math
from collections.abc import Sequence
from itertools import islice
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from deepfsi.base.errors import InputError, as_input_error, check_choice
from deepfsi.base.files import new_folder, read_toml
from deepfsi.base.progress import SILENT, Progress
from deepfsi.camera.camera import Camera
from deepfsi.camera.device import Device
from deepfsi.camera.layout import DmdGrid
from deepfsi.counting.acquisition import Acquisition, Homography
from deepfsi.counting.events import PtuWriter
from deepfsi.counting.recording import Recording
from deepfsi.lab.virtual_detector import DETECTOR_TICK_S, Detector, Stream, divide
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.frames import unpack
from deepfsi.patterns.manifest import Manifest

FRAME_MARKER = 1
"""Bits of the marker at the start of each frame."""


class VirtualCamera(Detector):
    """Optics and detector; the default is ideal. The attributes of `Detector` are its too."""

    # Homography display -> device in unit squares, (across, down, 1)
    view: Homography = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    # Standard deviation of a Gaussian on the device, mirrors
    blur: float = Field(0.0, ge=0, le=1000)
    # Share of the light that the corners of the area lose; it grows with the squared distance from
    # the centre
    vignetting: float = Field(0.0, ge=0, le=1)
    # Stray light spread evenly over the whole device, photons/s
    ambient: float = Field(0.0, ge=0, le=1e12)
    # Relative standard deviation of the light from picture to picture
    fluctuation: float = Field(0.0, ge=0, le=10)
    # Efficiency of each detector, of those that see mirrors ON first, over `efficiency`
    gains: tuple[Annotated[float, Field(gt=0, le=1)], ...] | None = None
    # True of a device that turns mirrors ON where the files have a 0
    inverted: bool = False

    @classmethod
    def load(cls, source: str) -> "VirtualCamera":
        """One of `CAMERAS` by its name, or of a TOML file; `InputError` if it is neither."""
        if not source.lower().endswith(".toml"):
            check_choice("camera", source, CAMERAS)
            return CAMERAS[source]
        with as_input_error():
            return cls.model_validate(read_toml(source))

    @classmethod
    def of(cls, camera: Camera) -> "VirtualCamera":
        """One with the dark counts, dead time and fluctuating light of a laboratory's camera."""
        # Its flux is of counts: the efficiency of the detector is in it
        return cls(
            dark=camera.dark,
            dead_time_s=camera.dead_time,
            paralysable=camera.dead_time_model == "paralysable",
            fluctuation=camera.fluctuation,
        )

    def light_text(self, photons: float) -> str:
        """Words on what the efficiency leaves of the photons of an exposure."""
        return (
            f"{photons:.4g} photons in an exposure, of which an efficiency of {self.efficiency:g} "
            f"leaves {self.efficiency * photons:.4g}"
        )

    def fluctuate(self, rates: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Arrivals/s (p, inputs) of pictures, each with a random level; dark counts are steady."""
        if not self.fluctuation:
            return rates
        # Log-normal, with the mean 1
        sigma = math.sqrt(math.log1p(self.fluctuation**2))
        levels = np.exp(sigma * rng.standard_normal((len(rates), 1)) - sigma**2 / 2)
        return np.asarray((rates - self.dark) * levels + self.dark)


CAMERAS = {
    "ideal": VirtualCamera(),
    "pmt": VirtualCamera(
        efficiency=0.2,
        dark=100.0,
        dead_time_s=20e-9,
        paralysable=True,
        afterpulse_probability=0.01,
        afterpulse_s=500e-9,
        jitter_s=85e-12,
    ),
    "spad": VirtualCamera(
        efficiency=0.73,
        dark=500.0,
        dead_time_s=28.5e-9,
        afterpulse_probability=0.01,
        afterpulse_s=50e-9,
        jitter_s=64e-12,
    ),
}
"""Cameras by name, with ideal optics.

pmt
    A photomultiplier as the paper's (PicoQuant PMA series), with assumed, typical values: 200 ps of
    jitter (full width at half maximum), afterpulses within microseconds (ions). The dead time is of
    the order that PicoQuant's MultiHarp 150 manual (3.1, section 2.1) gives for detector and
    electronics together; its hybrid detectors (2.3.4) have virtually no afterpulses.
spad
    A silicon avalanche diode: efficiency at 560 nm and 150 ps of jitter (full width) from M.
    Stipčević et al., J. Lightwave Technol. 31 (2013) 3591, doi:10.1109/JLT.2013.2286422; dead time
    of M. Chen et al., Electronics 9 (2020) 1131; dark counts and afterpulses assumed.
"""


def irradiance(
    scenes: np.ndarray, camera: VirtualCamera, device: Device, grid: DmdGrid
) -> np.ndarray:
    """Relative irradiance (S, rows, columns) of each mirror by scenes (S, h, w)."""
    from scipy.fft import irfft2, rfft2
    from scipy.ndimage import fourier_gaussian

    height, width = grid.lattice_shape
    blur = camera.blur * (math.sqrt(2) if grid.diamond else 1)  # half diagonals, or mirrors
    edge = math.ceil(4 * blur)
    down = (np.arange(-edge, height + edge) + 0.5) / height
    across = (np.arange(-edge, width + edge) + 0.5) / width
    pixel, inside = _find_pixels(camera, down, across, scenes.shape[1:])
    kept = slice(edge, edge + height), slice(edge, edge + width)
    x = across[kept[1]] - 0.5
    y = down[kept[0]] - 0.5
    corner = 2 * (x**2 + y[:, None] ** 2)  # 1 in the corners
    share = ((1 - camera.vignetting * corner) / grid.mirrors).astype(np.float32)
    out = np.zeros((len(scenes), device.rows, device.columns), dtype=np.float32)
    for scene, mirrors in zip(scenes, out, strict=True):
        image = np.where(inside, scene.ravel()[pixel], 0).astype(np.float32)
        if blur:
            spectrum = fourier_gaussian(rfft2(image), blur, n=image.shape[1])
            image = np.maximum(irfft2(spectrum, image.shape), 0)
        mirrors[grid.window] = grid.at_mirrors(image[kept] * share)
    return out


def _find_pixels(
    camera: VirtualCamera, down: np.ndarray, across: np.ndarray, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Pixel of a scene seen at each point (down, across) of the device, and whether one is."""
    back = np.linalg.inv(np.array(camera.view))
    x, y, depth = (row[0] * across + row[1] * down[:, None] + row[2] for row in back)
    ahead = depth * np.sign(back[2] @ [0.5, 0.5, 1.0]) > 0  # of the camera, not behind it
    depth = np.where(ahead, depth, np.inf)
    column = np.floor(x / depth * shape[1])
    row = np.floor(y / depth * shape[0])
    inside = ahead & (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
    return np.where(inside, row * shape[1] + column, 0).astype(np.intp), inside


def _mirrors_of_arm(manifest: Manifest) -> list[np.ndarray | slice]:
    """Mirrors that each detector of an arm sees, as indices of the flattened device."""
    if manifest.detectors is None:
        return [slice(None)]
    if manifest.detectors.labels is None:
        raise InputError(
            f"these patterns are for {manifest.detector_count} detectors, and nothing says which "
            "cells each sees: give patterns of a design"
        )
    grid = manifest.grid
    labels = manifest.detectors.labels[grid.pixels].repeat(grid.height, axis=0)
    of_mirrors = np.full((manifest.device.rows, manifest.device.columns), -1)
    of_mirrors[grid.window] = labels.repeat(grid.width, axis=1)
    return [np.flatnonzero(of_mirrors == detector) for detector in range(manifest.detector_count)]


class MirrorLight:
    """Light of scenes on the mirrors, and its part that frames send to the detectors."""

    def __init__(
        self, manifest: Manifest, scenes: np.ndarray, camera: VirtualCamera, flux: float
    ) -> None:
        self._camera = camera
        self._arms = manifest.arms
        self._device = device = manifest.device
        self._mirrors = _mirrors_of_arm(manifest)
        image = irradiance(scenes, camera, device, manifest.grid).reshape(len(scenes), -1)
        self._light = [image[:, mirrors] for mirrors in self._mirrors]
        cells = np.zeros((device.rows, device.columns), np.float32)
        cells[manifest.grid.window] = 1
        self._inside = cells.ravel()
        self._flux = flux / manifest.summed_reflectance
        self._stray = camera.ambient / (device.rows * device.columns)
        if camera.gains is not None and len(camera.gains) != manifest.inputs:
            raise InputError(
                f"the camera has {len(camera.gains)} gains, and the patterns are for "
                f"{manifest.inputs} detectors: give one for each"
            )
        self._gains = camera.efficiency * np.array(camera.gains or 1.0)

    def rates(self, frames: Sequence[np.ndarray]) -> np.ndarray:
        """Arrivals/s (S, F, inputs) at each detector behind packed frames, before dead time."""
        lit = np.stack([unpack(frame, self._device).ravel() for frame in frames])
        on = (lit ^ self._camera.inverted).astype(np.float32)
        out = []
        for arm in range(self._arms):
            for mirrors, light in zip(self._mirrors, self._light, strict=True):
                seen = on[:, mirrors] if arm == 0 else 1 - on[:, mirrors]
                photons = (seen @ light.T).astype(np.float64) * self._flux
                out.append(photons + (seen @ self._inside[mirrors])[:, None] * self._stray)
        # from (inputs, F, S)
        return np.stack(out).transpose(2, 1, 0) * self._gains + self._camera.dark


def arrival_rates(
    patterns: Patterns,
    scenes: np.ndarray,
    camera: VirtualCamera,
    flux: float,
    report: Progress = SILENT,
) -> np.ndarray:
    """Arrivals/s (S, F, inputs) at each detector while each frame is shown, before dead time."""
    manifest = patterns.manifest
    images = check_scenes(scenes, manifest, flux)
    frames = len(manifest.frames)
    out = np.empty((len(images), frames, manifest.inputs))
    # The light of 64 scenes on all mirrors fits the memory
    for first in range(0, len(images), 64):
        block = images[first : first + 64]
        light = MirrorLight(manifest, block, camera, flux)
        done = 0
        unread = patterns.frames()
        while batch := list(islice(unread, 16)):
            out[first : first + len(block), done : done + len(batch)] = light.rates(batch)
            done += len(batch)
            report((first * frames + done * len(block)) / (len(images) * frames))
    return out


def check_scenes(scenes: np.ndarray, manifest: Manifest, flux: float) -> np.ndarray:
    """Images (S, h, w) of scenes; `InputError` if they or their flux cannot be simulated."""
    # No counter takes more, and each photon takes memory
    if not 0 <= flux <= 1e10:
        raise InputError(f"a flux of {flux!r} is not allowed: give 0 to 1e10 photons/s")
    spectra = len(manifest.image_shape) == 1
    images = scenes[:, None, :] if spectra and scenes.ndim == 2 else scenes
    if images.ndim != 3 or not images.size or not np.isfinite(images).all() or images.min() < 0:
        raise InputError(
            f"scenes of shape {scenes.shape} are no images: give (S, h, w) of finite numbers, 0 or "
            "more"
        )
    return images


def record_scenes(
    out: Path,
    patterns: Patterns,
    scenes: np.ndarray,
    acquisition: Acquisition,
    report: Progress = SILENT,
) -> Acquisition:
    """Write the folder, new, of a recording in which the virtual camera looks at scenes in turn.

    `acquisition` has the camera, flux and seed. Returns the acquisition of the folder.
    """
    camera = VirtualCamera.model_validate(acquisition.camera)
    manifest = patterns.manifest
    flux = acquisition.flux or 0.0
    with new_folder(out) as draft:
        acquisition = Recording.prepare(draft, patterns, acquisition).acquisition
        flow = arrival_rates(patterns, scenes, camera, flux, report=report.between(0, 0.5))
        write_photons(
            draft / "photons.ptu",
            manifest,
            flow,
            camera,
            rng=np.random.default_rng(acquisition.seed or 0),
            inputs=acquisition.inputs,
            report=report.between(0.5, 1),
        )
    return acquisition


class EventRecorder:
    """Events of a camera's detectors, written in order of time."""

    def __init__(
        self, camera: VirtualCamera, rng: np.random.Generator, inputs: Sequence[int]
    ) -> None:
        self.inputs = inputs  # of the file, one for each detector
        self.writer: PtuWriter | None = None
        self.end = 0  # ticks up to which the detectors' light is known
        self._camera = camera
        self._streams = [Stream(camera, rng) for _ in inputs]
        self._rng = rng
        self._times = [np.zeros(0, np.int64)]
        self._codes = [np.zeros(0, np.int64)]

    @property
    def reach(self) -> int:
        """Most ticks by which a later event may lie before `end`."""
        return self._streams[0].reach

    def add(self, times: np.ndarray, code: int) -> None:
        """Take in events with one code: a photon's input, or a marker's bits, negative."""
        self._times.append(np.maximum(times, 0))
        self._codes.append(np.full(len(times), code))

    def see(self, durations: np.ndarray, rates: np.ndarray, report: Progress = SILENT) -> None:
        """Draw and write the events of pictures that last ticks (p,), at rates (p, inputs)."""
        last = self.end + int(durations.sum())
        for lengths, steady in divide(durations, self._camera.fluctuate(rates, self._rng)):
            for input_, stream, rate in zip(self.inputs, self._streams, steady.T, strict=True):
                self.add(stream.events(self.end, lengths, rate), input_)
            self.end += int(lengths.sum())
            self.write(self.end - self.reach)
            report(self.end / last)

    def write(self, end: int) -> None:
        """Write the events before a tick, before which no later draw may lie."""
        times = np.concatenate(self._times)
        order = np.argsort(times, kind="stable")
        times = times[order]
        codes = np.concatenate(self._codes)[order]
        ready = int(np.searchsorted(times, end))
        if self.writer is not None and ready:
            self.writer.write(times[:ready], codes[:ready])
        self._times = [times[ready:]]
        self._codes = [codes[ready:]]


def write_photons(
    path: Path,
    manifest: Manifest,
    rates: np.ndarray,
    camera: VirtualCamera,
    rng: np.random.Generator,
    inputs: Sequence[int] | None = None,
    report: Progress = SILENT,
) -> None:
    """Write the photons and markers of a pass for each scene, at rates (S, F, inputs)."""
    numbers = range(rates.shape[2]) if inputs is None else inputs
    picture = np.array([frame.picture_us for frame in manifest.frames], dtype=np.int64)
    durations = np.tile(picture * round(1e-6 / DETECTOR_TICK_S), len(rates))
    marks = np.cumsum(durations) - durations
    recorder = EventRecorder(camera, rng, numbers)
    recorder.add(marks, -FRAME_MARKER)
    with PtuWriter(path, tick_s=DETECTOR_TICK_S) as recorder.writer:
        recorder.see(durations, rates.reshape(len(durations), -1), report)
        recorder.write(recorder.end)
