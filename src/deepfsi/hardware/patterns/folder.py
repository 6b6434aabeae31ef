"""Folder of patterns: rails of a design to binary frames, and back.

A folder holds `manifest.json`, `mirrors.npy` (mirrors ON in each cell of each mask's frame), the
design if it was given, and the frames of all masks and sentinels (`frame_files`).
"""

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

import numpy as np

from deepfsi.errors import InputError, as_input_error, closest
from deepfsi.files import new_folder
from deepfsi.hardware.patterns.frame_files import (
    STREAMS,
    check_hash,
    load_frames,
    open_array,
    write_frames,
)
from deepfsi.hardware.patterns.mirrors import count_mirrors, make_frames, recount, sentinel, unpack
from deepfsi.hardware.patterns.sequence import (
    MOST_FRAMES,
    Device,
    Format,
    Frame,
    Grid,
    Manifest,
    Patterns,
    Selection,
    find_grid,
)

LIGHTS = ("column", "equal-dwell", "free-dwell", "two-arm")
FORMATS = (*STREAMS, "png")

SLACK = 1e-4
"""Share of the exposure by which two arms' times may differ between pixels."""

LONGEST_S = 1e3
"""Longest picture, seconds."""


def export_patterns(
    rails: np.ndarray,
    light: str,
    image_shape: tuple[int, ...],
    device: Device,
    dwell_s: float,
    folder: str | os.PathLike[str],
    *,
    summed_reflectance: float,
    selection: Selection = "ordered",
    seed: int = 0,
    format: Format = "npy",
    design: bytes | None = None,
    progress: Callable[[float], None] | None = None,
) -> Patterns:
    """Write what a device shows for a design, frame by frame, into a new folder.

    Parameters
    ----------
    rails : array, shape (2 or 1, m, N)
        Shares of each pixel's photons, as a design holds them.
    light : {"column", "equal-dwell", "free-dwell", "two-arm"}
        The constraint that they obey.
    image_shape : tuple of int
        Cells of a mask, 1 or 2 axes.
    device : Device
    dwell_s : float
        Mean picture time of the masks' frames in seconds, at least the device's shortest. Under
        `equal-dwell` it is every frame's. Otherwise what a picture lasts beyond the time to
        settle is in proportion to its share of the exposure; times are rounded up to whole
        microseconds and to the device's shortest.
    folder : path
        New or empty. It appears when it is whole.
    summed_reflectance : float
        s, mean summed reflectance of the training scenes.
    selection : {"ordered", "random"}
    seed : int
        For `random`.
    format : {"npy", "png", "raw"}
    design : bytes, optional
        The design's file, kept beside the frames.
    progress : function, optional
        Called with the share done.

    Returns
    -------
    Patterns
        With the realised matrix. Where the shares of the exposure would sum to more than 1
        (`column`), all are dimmed by the common factor `manifest.dimmed`.

    Raises
    ------
    InputError
        If the device cannot show the rails, or the folder holds something.
    """
    target = Path(folder)
    grid = find_grid(device, image_shape)
    rails = _check_rails(rails, light, image_shape)
    _check_settings(target, dwell_s, summed_reflectance, selection, seed, format)
    shown, peaks, on = count_mirrors(rails, light, grid.mirrors)
    if not shown:
        raise InputError("every mask is dark, so there is nothing to show: give a lit design")
    if len(shown) > MOST_FRAMES - 4:
        raise InputError(f"{len(shown)} frames are too many: give at most {MOST_FRAMES - 4}")
    dimmed = min(1.0, 1 / float(peaks.sum()))
    shares = np.minimum(peaks * dimmed, 1.0)
    pictures = _picture_us(shares, light, device, dwell_s)
    every = _sequence(on, device, grid, selection, seed)
    with new_folder(target) as draft:
        hashes = write_frames(draft, format, device, len(shown) + 4, every, progress)
        masks = [
            Frame(role="mask", mask=mask, rail=rail, share=share, picture_us=us, sha256=sha256)
            for (mask, rail), share, us, sha256 in zip(
                shown, shares.tolist(), pictures, hashes[2:-2], strict=True
            )
        ]
        sentinel = max(device.shortest_us, _whole(dwell_s * 1e6))
        ends = (
            Frame(role="on", picture_us=sentinel, sha256=hashes[0]),
            Frame(role="off", picture_us=sentinel, sha256=hashes[1]),
        )
        manifest = Manifest(
            deepfsi=version("deepfsi"),
            device=device,
            image_shape=tuple(map(int, image_shape)),
            masks=rails.shape[1],
            rails=2 if len(rails) == 2 else 1,
            light=light,
            dimmed=dimmed,
            summed_reflectance=float(summed_reflectance),
            selection=selection,
            seed=seed,
            format=format,
            design_sha256=None if design is None else hashlib.sha256(design).hexdigest(),
            frames=(*ends, *masks, *ends),
        )
        np.save(draft / "mirrors.npy", on)
        if design is not None:
            (draft / "design.safetensors").write_bytes(design)
        manifest = manifest.model_copy(update={"sha256": _digest(manifest.model_dump_json())})
        (draft / "manifest.json").write_text(manifest.model_dump_json(indent=1), encoding="utf-8")
    return Patterns(manifest, on)


def read_patterns(folder: str | os.PathLike[str]) -> Patterns:
    """What a folder of patterns shows, without reading its frames.

    Raises
    ------
    InputError
        If the manifest or the mirror counts are missing, damaged or do not fit each other.
    """
    path = Path(folder) / "manifest.json"
    try:
        content = path.read_bytes()
        with as_input_error(str(path), "export the patterns again"):
            manifest = Manifest.model_validate_json(content)
    except OSError as error:
        raise InputError(
            f"no patterns in {folder} ({error.strerror}): make them with `deepfsi dmd export`"
        ) from None
    _check_manifest(manifest, path)
    if manifest.sha256 not in (None, _digest(content)):
        raise InputError(
            f"{path} was changed after it was written: export the patterns again, or remove its "
            "sha256 to use it as it is"
        )
    shape = (len(manifest.shown), math.prod(manifest.image_shape))
    counts = Path(folder) / "mirrors.npy"
    with open_array(counts, "<u4", shape, first=int(manifest.shown[0])) as file:
        on = np.frombuffer(file.read(4 * math.prod(shape)), "<u4").reshape(shape)
    if on.max(initial=0) > manifest.grid.mirrors:
        raise InputError(
            f"{counts} has cells with more than their {manifest.grid.mirrors} mirrors: export the "
            "patterns again"
        )
    return Patterns(manifest, on.astype(np.uint32, copy=False))


def read_frames(folder: str | os.PathLike[str]) -> Iterator[np.ndarray]:
    """Packed frames of a folder in their order, one at a time.

    Yields
    ------
    array, shape (rows, bytes of a row)
        uint8.

    Raises
    ------
    InputError
        If a frame is missing or damaged so that it cannot be read.
    """
    yield from load_frames(Path(folder), read_patterns(folder).manifest)


def check_patterns(
    folder: str | os.PathLike[str], progress: Callable[[float], None] | None = None
) -> Patterns:
    """Read every frame of a folder and compare it with the manifest and the mirror counts.

    Parameters
    ----------
    folder : path
    progress : function, optional
        Called with the share done.

    Raises
    ------
    InputError
        Naming the first frame that is missing or not what was exported.
    """
    folder = Path(folder)
    patterns = read_patterns(folder)
    manifest, grid = patterns.manifest, patterns.manifest.grid
    total = len(manifest.frames)
    rows = iter(patterns.on)
    for place, frame in enumerate(load_frames(folder, manifest)):
        known = manifest.frames[place]
        name = f"frame {place} of {folder} ({describe(known)})"
        if hashlib.sha256(frame.data).hexdigest() != known.sha256:
            raise InputError(f"{name} is not what was exported: export the patterns again")
        mirrors = unpack(frame, manifest.device)
        if known.role == "mask":
            same = np.array_equal(recount(mirrors, grid), next(rows))
        else:
            same = np.array_equal(mirrors, sentinel(manifest.device, grid, known.role == "on"))
        if not same:
            raise InputError(
                f"{name} does not show what manifest.json and mirrors.npy say: export the "
                "patterns again"
            )
        if progress is not None:
            progress((place + 1) / total)
    if manifest.design_sha256 is not None:
        check_hash(folder / "design.safetensors", manifest.design_sha256)
    return patterns


def describe(frame: Frame) -> str:
    """A frame in words."""
    if frame.role != "mask":
        return f"all {frame.role.upper()}"
    return f"mask {frame.mask}" + ("" if frame.rail == "both" else f", {frame.rail}")


def _sequence(
    on: np.ndarray, device: Device, grid: Grid, selection: Selection, seed: int
) -> Iterator[np.ndarray]:
    """All frames: sentinels, masks, sentinels."""
    bright, dark = (np.packbits(sentinel(device, grid, lit), axis=1) for lit in (True, False))
    yield from (bright, dark)
    yield from make_frames(on, device, grid, selection, seed)
    yield from (bright, dark)


def _check_manifest(manifest: Manifest, path: Path) -> None:
    _ = manifest.grid  # the device must hold the cells
    if manifest.light not in LIGHTS:
        raise InputError(f"{path} has light {manifest.light!r}: {closest(manifest.light, LIGHTS)}")
    if manifest.two_arm != (manifest.light == "two-arm") or not len(manifest.shown):
        raise InputError(f"the rails in {path} are not those of {manifest.light}: export again")


def _digest(manifest: str | bytes) -> str:
    """Hash of a manifest's JSON but for the hash itself, whatever its layout."""
    content = {key: value for key, value in json.loads(manifest).items() if key != "sha256"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _check_rails(rails: np.ndarray, light: str, image_shape: tuple[int, ...]) -> np.ndarray:
    rails = np.asarray(rails)
    if light not in LIGHTS:
        raise InputError(f"unknown light constraint {light!r}: {closest(light, LIGHTS)}")
    pixels = math.prod(image_shape)
    if (
        rails.ndim != 3
        or len(rails) not in (1, 2)
        or not rails.shape[1]
        or rails.shape[2] != pixels
    ):
        raise InputError(
            f"rails of shape {rails.shape} are not allowed: give (2 or 1, masks, {pixels})"
        )
    if light == "two-arm" and len(rails) != 2:
        raise InputError("two-arm with a single rail is not allowed: give both arms' rails")
    if not np.isfinite(rails).all() or rails.min() < 0:
        raise InputError("rails must be finite and 0 or more: give shares of each pixel's photons")
    if light == "two-arm" and np.ptp(rails.sum(axis=0), axis=-1).max() * rails.shape[1] > SLACK:
        raise InputError("the two arms of a mask do not sum to one time for all of its pixels")
    return rails


def _check_settings(
    target: Path, dwell_s: float, summed_reflectance: float, selection: str, seed: int, format: str
) -> None:
    if not (math.isfinite(dwell_s) and 0 < dwell_s <= LONGEST_S):
        raise InputError(
            f"dwell {dwell_s!r} is not allowed: give seconds above 0, up to {LONGEST_S:g}"
        )
    if not (math.isfinite(summed_reflectance) and summed_reflectance > 0):
        raise InputError(f"mean light {summed_reflectance!r} is not allowed: give a number above 0")
    if selection not in ("ordered", "random"):
        raise InputError(
            f"unknown selection {selection!r}: {closest(selection, ('ordered', 'random'))}"
        )
    if seed < 0:
        raise InputError(f"seed {seed} is not allowed: give 0 or more")
    if format not in FORMATS:
        raise InputError(f"unknown format {format!r}: {closest(format, FORMATS)}")
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"{target} exists already: give a new folder")


def _picture_us(shares: np.ndarray, light: str, device: Device, dwell_s: float) -> list[int]:
    mean = max(dwell_s * 1e6, device.shortest_us)
    if light == "equal-dwell":
        return [_whole(mean)] * len(shares)
    rest = mean - device.settle_us
    if rest <= 0:
        raise InputError(
            f"a dwell of {dwell_s:g} s leaves no time after {device.settle_us:g} µs to settle: "
            "give a longer one"
        )
    wanted = device.settle_us + rest * len(shares) * shares / shares.sum()
    if wanted.max() > 1e6 * LONGEST_S:
        raise InputError(
            f"with a dwell of {dwell_s:g} s the longest picture takes {wanted.max() / 1e6:.3g} s, "
            f"and {LONGEST_S:g} are allowed: give a shorter one"
        )
    return [max(device.shortest_us, _whole(us)) for us in wanted.tolist()]


def _whole(us: float) -> int:
    """Rounded up, but for what floating point adds."""
    return math.ceil(round(us, 6))
