"""The folder of a recording: what was shown and recorded, and photons counted frame by frame.

    acquisition.json   scenes, exposure, settle time (`Acquisition`)
    patterns/          manifest.json, mirrors.npy and the design of the patterns shown, no frames
    photons.ptu        photons and frame markers, as the vendor's software or a virtual camera wrote
    counts.npz         photons of each readout (`Counts`), written by `count`
    calibration/       spot scans and flat fields, if there are any

A recording can be counted again for another exposure: gates are shorter or longer, and as many
follow each other in a frame as there are repeats.
"""

import io
import json
import math
import os
import struct
import zipfile
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.linalg import lstsq

from deepfsi.errors import InputError, as_input_error
from deepfsi.files import new_folder, write_atomically
from deepfsi.hardware.patterns.folder import read_patterns
from deepfsi.hardware.patterns.gates import Gates, find_gates
from deepfsi.hardware.patterns.sequence import Manifest, Patterns
from deepfsi.hardware.ptu.header import read_header
from deepfsi.hardware.ptu.reader import count_gates, read_markers
from deepfsi.hardware.recording.alignment import MOST_PLACES, Alignment, Fault, align, find_steps
from deepfsi.progress import SILENT, Report

__all__ = [
    "Acquisition",
    "Alignment",
    "Counts",
    "Fault",
    "Scene",
    "align",
    "count",
    "picture",
    "prepare",
    "read_acquisition",
    "read_counts",
]

MOST_READOUTS = 2**21
"""Gates, and readouts, that are counted at once."""

LARGEST_JSON = 2**24
LARGEST_COUNTS = 2**27
"""Bytes."""

FINEST = 10
"""Ticks of the counter that a gate must have at least."""

WEAKEST = 1e-3
"""Least singular value of the sensing matrix, of its largest, that a picture is made from."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Scene(BaseModel):
    """One scene.

    Attributes
    ----------
    name : str
    label : str or None
        Its class, where known.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(max_length=1000)
    label: str | None = Field(None, max_length=1000)


class Acquisition(BaseModel):
    """How scenes were recorded: one pass over the patterns each, one after another.

    Attributes
    ----------
    scenes : tuple of Scene
        In the order of their passes.
    exposure_s : float
        Total exposure over the masks' frames, seconds.
    settle_s : float
        Time before the first gate of each frame, seconds.
    repeats : int
        Gates in each frame.
    marker_bit : {1, 2, 4, 8}
        Which of the counter's marker inputs the device's trigger is wired to.
    inputs : tuple of int
        Of the counter, 0 for input 1: one, or on two arms the one that sees mirrors ON and the one
        that sees mirrors OFF.
    flux : float or None
        Photons/s on the device for the training scenes' mean, where known.
    camera : dict or None
        Settings of a virtual camera.
    seed : int or None
        Of a virtual recording.
    manifest_sha256 : str or None
        Of the bytes of patterns/manifest.json; `prepare` fills it in.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: Literal[1] = 1
    scenes: tuple[Scene, ...] = Field(min_length=1, max_length=2**16)
    exposure_s: Positive
    settle_s: float = Field(ge=0, allow_inf_nan=False)
    repeats: int = Field(ge=1, le=MOST_READOUTS)
    marker_bit: Literal[1, 2, 4, 8] = 1
    inputs: tuple[Annotated[int, Field(ge=0, le=63)], ...] = Field((0,), min_length=1, max_length=2)
    flux: Positive | None = None
    camera: dict[str, Any] | None = None
    seed: int | None = None
    manifest_sha256: str | None = Field(None, pattern=r"^[0-9a-f]{64}$")

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        if len(set(self.inputs)) < len(self.inputs):
            raise ValueError("two arms need two inputs")
        return self


@dataclass(frozen=True)
class Counts:
    """Photons of each readout.

    Attributes
    ----------
    counts : array, shape (S, R, rails, m)
        int64; 0 for a rail that is dark and for an exposure that is not valid.
    valid : array, shape (S, R)
        bool; whether all readouts of an exposure were recorded.
    gate_s : array, shape (f,)
        For how long each mask's frame is counted, seconds.
    on_rate, off_rate : array, shape (S,)
        Counts/s of the first input in all-ON and all-OFF frames; NaN where a scene is not valid.
    dark_rate : array, shape (rails,)
        Counts/s of the input that reads each rail, when no mirror sends it light: means over
        scenes, of all-OFF frames, or of all-ON ones for the second arm.
    exposure_s : float
        Total exposure, seconds.
    settle_s : float
        Time before the first gate of each frame, seconds.
    lengths_s : array, shape (rails, m)
        For how long each readout is counted, seconds; 0 for a rail that is dark.
    faults : tuple of Fault
        What was wrong with the recording.
    """

    counts: np.ndarray
    valid: np.ndarray
    gate_s: np.ndarray
    on_rate: np.ndarray
    off_rate: np.ndarray
    dark_rate: np.ndarray
    exposure_s: float
    settle_s: float
    lengths_s: np.ndarray
    faults: tuple[Fault, ...]

    @property
    def background(self) -> np.ndarray:
        """Dark counts that each readout is expected to hold, float64 (rails, m)."""
        return self.dark_rate[:, None] * self.lengths_s

    def signal(self) -> np.ndarray:
        """Counts less the background, float64 (S, R, rails, m)."""
        return self.counts - self.background * self.valid[..., None, None]

    @property
    def flux(self) -> float:
        """Counts/s of the scenes' light with all mirrors ON, mean over valid scenes."""
        return float(np.nanmean(self.on_rate - self.off_rate))

    @property
    def photons(self) -> float:
        """Budget Φ of an exposure, estimated from the all-ON frames: flux times exposure.

        In counts: the detector's efficiency is part of it.
        """
        return self.flux * self.exposure_s


# The folder --------------------------------------------------------------------------------------


def prepare(
    folder: str | os.PathLike[str],
    patterns_folder: str | os.PathLike[str],
    acquisition: Acquisition,
) -> Acquisition:
    """Make the folder of a recording, to which photons.ptu is then added.

    Parameters
    ----------
    folder : path
        New or empty. It appears when it is whole.
    patterns_folder : path
        The patterns that are shown.
    acquisition : Acquisition

    Returns
    -------
    Acquisition
        As written, with the hash of the manifest.

    Raises
    ------
    InputError
        If the folder holds something, or patterns and acquisition do not fit each other.
    """
    target, source = Path(folder), Path(patterns_folder)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"{target} exists already: give a new folder")
    patterns = read_patterns(source)
    names = ["manifest.json", "mirrors.npy"]
    if patterns.manifest.design_sha256 is not None:
        names.append("design.safetensors")
    try:
        content = {name: (source / name).read_bytes() for name in names}
    except OSError as error:
        raise InputError(f"{source} cannot be copied ({error.strerror}): export again") from None
    digest = sha256(content["manifest.json"]).hexdigest()
    if acquisition.manifest_sha256 not in (None, digest):
        raise InputError(f"the acquisition is of other patterns than those in {source}")
    acquisition = acquisition.model_copy(update={"manifest_sha256": digest})
    _check_fit(acquisition, patterns.manifest, "the acquisition")
    with new_folder(target) as draft:
        (draft / "calibration").mkdir()
        (draft / "patterns").mkdir()
        for name, held in content.items():
            (draft / "patterns" / name).write_bytes(held)
        text = acquisition.model_dump_json(indent=1)
        (draft / "acquisition.json").write_text(text, encoding="utf-8")
    return acquisition


def read_acquisition(folder: str | os.PathLike[str]) -> tuple[Acquisition, Patterns]:
    """What a folder says was shown and recorded, checked for consistency.

    Raises
    ------
    InputError
        If a file is missing, damaged, or does not fit the others.
    """
    path = Path(folder) / "acquisition.json"
    hint = "a folder that `deepfsi camera simulate` wrote has one, or write it with `prepare`"
    content = _read(path, LARGEST_JSON, hint)
    with as_input_error(str(path)):
        acquisition = Acquisition.model_validate_json(content)
    patterns = read_patterns(path.parent / "patterns")
    manifest = path.parent / "patterns" / "manifest.json"
    if sha256(manifest.read_bytes()).hexdigest() != acquisition.manifest_sha256:
        raise InputError(
            f"{manifest} is not the one that {path} was made with: copy the patterns that were "
            "shown"
        )
    _check_fit(acquisition, patterns.manifest, str(path))
    return acquisition, patterns


def _check_fit(acquisition: Acquisition, manifest: Manifest, name: str) -> None:
    """Raise `InputError` unless these patterns can be recorded so."""
    roles = [frame.role for frame in manifest.frames]
    ends = ["on", "off"]
    if len(roles) < 5 or roles[:2] != ends or roles[-2:] != ends or set(roles[2:-2]) != {"mask"}:
        raise InputError(
            f"{name} has patterns without an all-ON and an all-OFF frame at both ends: export them "
            "with `deepfsi dmd export`"
        )
    arms = 2 if manifest.two_arm else 1
    if len(acquisition.inputs) != arms:
        raise InputError(
            f"{name} has {len(acquisition.inputs)} inputs, and its patterns need {arms}: give one "
            "for each arm"
        )
    if len(acquisition.scenes) * len(roles) > MOST_PLACES:
        raise InputError(
            f"{name} has {len(acquisition.scenes)} scenes of {len(roles)} frames, and at most "
            f"{MOST_PLACES} frames are allowed: split it"
        )
    try:
        _find_gates(acquisition, manifest, None, None, None)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


# Counting ----------------------------------------------------------------------------------------


def count(
    folder: str | os.PathLike[str],
    *,
    exposure_s: float | None = None,
    settle_s: float | None = None,
    repeats: int | None = None,
    report: Report = SILENT,
) -> Counts:
    """Count the photons of each readout and write counts.npz.

    Parameters
    ----------
    folder : path
    exposure_s : float, optional
        Total exposure in seconds; as recorded unless given. Frames need not have been shown for it:
        a shorter one is a gate within them.
    settle_s : float, optional
        As recorded unless given.
    repeats : int, optional
        Exposures of each scene, from gates that follow each other in each frame. Unless given, as
        recorded, or with another exposure as many as fit (and are at most 2^21 readouts).
    report : Report
        Given the share that is done.

    Raises
    ------
    InputError
        If files are missing, damaged or do not fit each other, gates do not fit the frames, or no
        exposure is whole.
    """
    acquisition, patterns = read_acquisition(folder)
    manifest, scenes = patterns.manifest, len(acquisition.scenes)
    gates = _find_gates(acquisition, manifest, exposure_s, settle_s, repeats)
    plan = _Plan.of(manifest, gates)
    path = Path(folder) / "photons.ptu"
    header = read_header(path)
    if gates.length_s.min() < FINEST * header.tick_s:
        raise InputError(
            f"{path} has times in steps of {header.tick_s:g} s, too coarse for gates of "
            f"{gates.length_s.min():g} s: give a longer exposure"
        )
    times, bits = read_markers(path, report.part(0.0, 0.4))
    times = times[bits & acquisition.marker_bit != 0]
    end = int(times.max(initial=0)) - header.kind.wrap if header.problems else None

    def counter(starts: np.ndarray, stops: np.ndarray) -> np.ndarray:
        edges = np.stack([_ticks(starts, header.tick_s), _ticks(stops, header.tick_s)])
        edges = np.clip(edges, 0, end)
        unique, places = np.unique(edges, return_inverse=True)
        found = count_gates(path, unique[:-1], unique[1:], acquisition.inputs[:1])[:, 0]
        before = np.append(0, np.cumsum(found))[places.reshape(edges.shape)]
        return before[1] - before[0]

    try:
        aligned = align(times * header.tick_s, manifest, scenes, counter=counter)
    except InputError as error:
        raise InputError(f"{path} has {len(times)} frame markers: {error}") from None
    starts = aligned.starts_s.copy()
    last = float(times.max(initial=0)) * header.tick_s
    if header.problems:
        starts[starts >= last] = np.nan  # the frame that was being recorded when the file ended
    shown = starts[:, manifest.shown]
    # A mask's frame is whole if a marker came after it.
    whole = np.isfinite(shown).all(axis=1) & (shown[:, -1] < last)
    if not whole.any():
        why = aligned.faults[0] if aligned.faults else "it ends too early"
        raise InputError(f"{path} has no whole exposure ({why}): record again")
    opens = starts[whole][:, plan.frame] + plan.offset
    found, seconds = _count_windows(
        path, opens, plan.length, header.tick_s, acquisition.inputs, report.part(0.4, 1.0)
    )
    photons, spent = plan.sum_frames(found), plan.sum_frames(seconds)
    fits = np.array([_shows_ends(*each) for each in zip(photons[..., 0], spent, strict=True)])
    faults = list(aligned.faults)
    for scene in np.flatnonzero(whole)[~fits].tolist():
        detail = "its first and last frames are not the brightest and darkest: it may be shifted"
        faults.append(Fault(kind="lost", scene=scene, frame=None, detail=detail))
    if not fits.any():
        raise InputError(
            f"{path} has no pass that begins and ends with a bright and a dark frame: give the "
            "patterns that were shown, and the input that the detector is wired to"
        )
    whole[whole] = fits
    spent = np.where(spent > 0, spent, np.nan)
    rates = photons[fits] / spent[fits, :, None]
    exposure = acquisition.exposure_s if exposure_s is None else exposure_s
    counts = _assemble(manifest, gates, plan, whole, found[fits], rates, exposure, tuple(faults))
    _save(Path(folder) / "counts.npz", counts, acquisition)
    return counts


def _find_gates(
    acquisition: Acquisition,
    manifest: Manifest,
    exposure_s: float | None,
    settle_s: float | None,
    repeats: int | None,
) -> Gates:
    same = exposure_s is None and settle_s is None
    wanted = acquisition.repeats if repeats is None and same else repeats
    exposure = acquisition.exposure_s if exposure_s is None else exposure_s
    settle = acquisition.settle_s if settle_s is None else settle_s
    gates = find_gates(manifest, exposure, settle, wanted)
    shortest = min(manifest.picture_s[[0, 1, -2, -1]])
    if settle >= shortest:
        raise InputError(
            f"a settle time of {settle:g} s leaves nothing of the all-ON and all-OFF frames: give "
            f"less than {shortest:g}"
        )
    each = len(acquisition.scenes) * max(len(manifest.shown), manifest.rails * manifest.masks)
    most = MOST_READOUTS // each
    if most < 1:
        raise InputError(
            f"{len(acquisition.scenes)} scenes of {manifest.masks} masks are more than "
            f"{MOST_READOUTS} readouts: split the acquisition"
        )
    if gates.repeats <= most:
        return gates
    if wanted is not None:
        raise InputError(f"{wanted} repeats are too many to count at once: give at most {most}")
    return Gates(gates.settle_s, gates.length_s, most)


@dataclass(frozen=True)
class _Plan:
    """Windows of a pass in order: its gates, and what of each frame they leave after settling.

    Of each window its frame, when it opens after the frame's start and for how long (g,), and of
    the gates their places among the windows (f, R).
    """

    frame: np.ndarray
    offset: np.ndarray
    length: np.ndarray
    gates: np.ndarray
    frames: int

    @classmethod
    def of(cls, manifest: Manifest, gates: Gates) -> "_Plan":
        repeats, frames = gates.repeats, len(manifest.frames)
        each = np.ones(frames, np.int64)
        each[manifest.shown] += repeats
        frame = np.repeat(np.arange(frames), each)
        first = np.cumsum(each) - each
        places = first[manifest.shown][:, None] + np.arange(repeats)
        offset = np.full(len(frame), gates.settle_s)
        offset[places] = gates.starts_s
        offset[places[:, -1] + 1] = gates.settle_s + repeats * gates.length_s
        length = np.maximum(manifest.picture_s[frame] - offset, 0.0)
        length[places] = gates.length_s[:, None]
        return cls(frame, offset, length, places, frames)

    def sum_frames(self, values: np.ndarray) -> np.ndarray:
        """Sums over the windows of each frame: (..., g, ...) along the second axis."""
        return np.add.reduceat(values, np.searchsorted(self.frame, np.arange(self.frames)), axis=1)


def _count_windows(
    path: Path,
    opens: np.ndarray,
    length: np.ndarray,
    tick_s: float,
    inputs: tuple[int, ...],
    report: Report,
) -> tuple[np.ndarray, np.ndarray]:
    """Photons (S, g, inputs) in windows (S, g), and for how long each was open, seconds (S, g).

    Where two clocks and a marker's jitter make a window reach into the next it ends there. One
    whose frame's start is not known is not open.
    """
    known = np.isfinite(opens).ravel()
    starts = _ticks(opens.ravel()[known], tick_s)
    stops = _ticks((opens + length).ravel()[known], tick_s)
    starts = np.minimum.accumulate(starts[::-1])[::-1]
    stops[:-1] = np.minimum(stops[:-1], starts[1:])
    found = np.zeros((opens.size, len(inputs)), np.int64)
    seconds = np.zeros(opens.size)
    found[known] = count_gates(path, starts, stops, inputs, report)
    seconds[known] = (stops - starts) * tick_s
    return found.reshape(*opens.shape, len(inputs)), seconds.reshape(opens.shape)


def _shows_ends(photons: np.ndarray, seconds: np.ndarray) -> bool:
    """Whether a pass's first and last two frames are all ON and all OFF, as far as photons tell.

    At least one of each must have been recorded.
    """
    if not (seconds[[0, -2]].any() and seconds[[1, -1]].any()):
        return False
    fits, _ = find_steps(photons, seconds)
    return bool(fits[0] and fits[-1])


def _assemble(
    manifest: Manifest,
    gates: Gates,
    plan: _Plan,
    whole: np.ndarray,
    found: np.ndarray,
    rates: np.ndarray,
    exposure_s: float,
    faults: tuple[Fault, ...],
) -> Counts:
    """Order windows (whole scenes, g, inputs) and rates of frames (whole scenes, F, inputs)."""
    scenes, rails, masks = len(whole), manifest.rails, manifest.masks
    counts = np.zeros((scenes, gates.repeats, rails, masks), np.int64)
    lengths = np.zeros((rails, masks))
    for place, length, windows in zip(manifest.shown, gates.length_s, plan.gates, strict=True):
        frame = manifest.frames[place]
        for rail, column in _READ_BY[frame.rail]:
            counts[whole, :, rail, frame.mask] = found[:, windows, column]
            lengths[rail, frame.mask] = length
    on, off = np.nanmean(rates[:, [0, -2]], axis=1), np.nanmean(rates[:, [1, -1]], axis=1)
    on_rate, off_rate = np.full(scenes, np.nan), np.full(scenes, np.nan)
    on_rate[whole], off_rate[whole] = on[:, 0], off[:, 0]
    dark = np.full(rails, off[:, 0].mean())
    if manifest.two_arm:
        dark[1] = on[:, 1].mean()
    return Counts(
        counts=counts,
        valid=np.repeat(whole[:, None], gates.repeats, axis=1),
        gate_s=gates.length_s,
        on_rate=on_rate,
        off_rate=off_rate,
        dark_rate=dark,
        exposure_s=exposure_s,
        settle_s=gates.settle_s,
        lengths_s=lengths,
        faults=faults,
    )


def _ticks(seconds: np.ndarray, tick_s: float) -> np.ndarray:
    return np.rint(seconds / tick_s).astype(np.int64)


_READ_BY: dict[str | None, tuple[tuple[int, int], ...]] = {
    "plus": ((0, 0),),
    "minus": ((1, 0),),
    "both": ((0, 0), (1, 1)),
}
"""Rails for which a frame is read, and the place of their input."""


# The file of counts ------------------------------------------------------------------------------


def read_counts(folder: str | os.PathLike[str]) -> Counts:
    """Counts of a folder as `count` wrote them.

    Raises
    ------
    InputError
        If there are none, or they are damaged or of another acquisition.
    """
    acquisition, patterns = read_acquisition(folder)
    return _load(Path(folder) / "counts.npz", acquisition, patterns.manifest)


def _save(path: Path, counts: Counts, acquisition: Acquisition) -> None:
    about = {
        "acquisition": _digest(acquisition),
        "repeats": counts.counts.shape[1],
        "exposure_s": counts.exposure_s,
        "settle_s": counts.settle_s,
        "faults": [fault.model_dump() for fault in counts.faults],
    }
    text = np.frombuffer(json.dumps(about).encode(), np.uint8)
    arrays = {name: getattr(counts, name) for name in _ARRAYS}
    file = io.BytesIO()
    np.savez(file, about=text, **arrays)
    write_atomically(path, file.getvalue())


def _load(path: Path, acquisition: Acquisition, manifest: Manifest) -> Counts:
    content = _read(path, LARGEST_COUNTS, "make it with `deepfsi camera count`")
    damaged = InputError(
        f"{path} is not a whole file of counts: make it with `deepfsi camera count`"
    )
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            about = _About.model_validate_json(_member(archive, "about", "|u1", None).tobytes())
            if about.acquisition != _digest(acquisition):
                raise InputError(
                    f"{path} is of another acquisition than acquisition.json: count again with "
                    "`deepfsi camera count`"
                )
            scenes, rails, masks = len(acquisition.scenes), manifest.rails, manifest.masks
            shapes = {
                "counts": (scenes, about.repeats, rails, masks),
                "valid": (scenes, about.repeats),
                "gate_s": (len(manifest.shown),),
                "on_rate": (scenes,),
                "off_rate": (scenes,),
                "dark_rate": (rails,),
                "lengths_s": (rails, masks),
            }
            arrays = {
                name: _member(archive, name, dtype, shapes[name]) for name, dtype in _ARRAYS.items()
            }
    except InputError:
        raise
    except _UNREADABLE:
        raise damaged from None
    if arrays["valid"].view(np.uint8).max() > 1 or not arrays["valid"].any():
        raise damaged
    lit = arrays["valid"].any(axis=1)
    known = [arrays[name] for name in ("gate_s", "dark_rate", "lengths_s")]
    known += [arrays["on_rate"][lit], arrays["off_rate"][lit], arrays["counts"]]
    if not all(bool((np.isfinite(each) & (each >= 0)).all()) for each in known):
        raise damaged
    return Counts(
        **arrays, exposure_s=about.exposure_s, settle_s=about.settle_s, faults=about.faults
    )


class _About(BaseModel):
    """What a file of counts says of itself; `acquisition` is the hash of what was counted."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    acquisition: str
    repeats: int = Field(ge=1, le=MOST_READOUTS)
    exposure_s: Positive
    settle_s: float = Field(ge=0, allow_inf_nan=False)
    faults: tuple[Fault, ...]


_ARRAYS = {
    "counts": "<i8",
    "valid": "|b1",
    "gate_s": "<f8",
    "on_rate": "<f8",
    "off_rate": "<f8",
    "dark_rate": "<f8",
    "lengths_s": "<f8",
}

_UNREADABLE = (
    zipfile.BadZipFile,
    KeyError,
    ValueError,
    OSError,
    EOFError,
    NotImplementedError,
    RuntimeError,
    struct.error,
)
"""What zipfile raises of damaged archives, and pydantic of what is in them."""


def _member(
    archive: zipfile.ZipFile, name: str, dtype: str, shape: tuple[int, ...] | None
) -> np.ndarray:
    """Array of that type and shape, or a vector of any length; `ValueError` if it is none."""
    info = archive.getinfo(f"{name}.npy")
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > LARGEST_COUNTS:
        raise ValueError(name)
    content = archive.read(info)
    kind = np.dtype(dtype)
    if shape is None:
        shape = ((len(content) - _HEADER) // kind.itemsize,)
    header = io.BytesIO()
    about = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(header, about)
    held = header.getvalue()
    if len(content) != len(held) + kind.itemsize * math.prod(shape) or not content.startswith(held):
        raise ValueError(name)
    return np.frombuffer(content, kind, offset=len(held)).reshape(shape).copy()


_HEADER = 128
"""Bytes of the header of a vector in numpy's format."""


# Pictures ----------------------------------------------------------------------------------------


def picture(folder: str | os.PathLike[str]) -> np.ndarray:
    """Least-squares picture of each scene from its counts, less background.

    The mean of all valid exposures, and of all pictures that explain it the one of smallest norm.
    Directions that the masks hardly see are left out (singular values below 1e-3 of the largest).

    Returns
    -------
    array, shape (S, *image_shape)
        float64, NaN for a scene without a valid exposure. If the acquisition gives the flux, it is
        the reflectance times the detector's efficiency. Otherwise the budget is estimated from
        the all-ON frames, so that the scenes have the training scenes' mean light.

    Raises
    ------
    InputError
        As `read_counts`, or if the flux is not known and no light was seen.
    """
    acquisition, patterns = read_acquisition(folder)
    path = Path(folder) / "counts.npz"
    counts = _load(path, acquisition, patterns.manifest)
    budget = counts.photons if acquisition.flux is None else acquisition.flux * counts.exposure_s
    if not budget > 0:
        raise InputError(f"{path} has no light: its all-ON frames are not brighter than the dark")
    valid = np.asarray(counts.valid.any(axis=1))
    weights = counts.valid / np.maximum(counts.valid.sum(axis=1, keepdims=True), 1)
    mean = np.einsum("sr,srkm->skm", weights, counts.signal())[valid]
    read = counts.lengths_s > 0
    found = lstsq(patterns.rails[read], mean[:, read].T, cond=WEAKEST)[0].T
    out = np.full((len(valid), found.shape[1]), np.nan)
    out[valid] = found * (patterns.manifest.summed_reflectance / budget)
    return out.reshape(len(valid), *patterns.manifest.image_shape)


# Reading -----------------------------------------------------------------------------------------


def _read(path: Path, largest: int, hint: str) -> bytes:
    """Content of a file that is not larger than it can be."""
    try:
        with path.open("rb") as file:
            content = file.read(largest + 1)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): {hint}") from None
    if len(content) > largest:
        raise InputError(f"{path} has more than {largest} bytes: {hint}")
    return content


def _digest(acquisition: Acquisition) -> str:
    return sha256(acquisition.model_dump_json().encode()).hexdigest()
