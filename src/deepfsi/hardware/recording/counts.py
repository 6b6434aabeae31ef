"""Photon counts of each readout, and their file counts.npz."""

import io
import json
import math
import os
import struct
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from deepfsi.errors import InputError
from deepfsi.files import write_atomically
from deepfsi.hardware.patterns.sequence import Manifest
from deepfsi.hardware.recording.acquisition import (
    MOST_READOUTS,
    Acquisition,
    Positive,
    read_acquisition,
    read_limited,
)
from deepfsi.hardware.recording.faults import Fault

LARGEST_COUNTS = 2**27
"""Bytes of counts.npz at most."""

NPY_HEADER = 128
"""Bytes of the header of a vector in numpy's format."""

_UNREADABLE = (
    zipfile.BadZipFile,
    KeyError,
    ValueError,
    OSError,
    EOFError,
    RuntimeError,
    struct.error,
)
"""What zipfile raises of damaged archives, and pydantic of what is in them."""


@dataclass(frozen=True)
class Counts:
    """Photon counts of each readout.

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

    def save(self, path: Path, acquisition: Acquisition) -> None:
        """Write counts.npz, with the hash of the acquisition that was counted."""
        about = {
            "acquisition": acquisition.digest,
            "repeats": self.counts.shape[1],
            "exposure_s": self.exposure_s,
            "settle_s": self.settle_s,
            "faults": [fault.model_dump() for fault in self.faults],
        }
        text = np.frombuffer(json.dumps(about).encode(), np.uint8)
        arrays: dict[str, Any] = {
            name: held for name, held in vars(self).items() if isinstance(held, np.ndarray)
        }
        file = io.BytesIO()
        np.savez(file, about=text, **arrays)
        write_atomically(path, file.getvalue())


def read_counts(folder: str | os.PathLike[str]) -> Counts:
    """Counts of a folder as `count` wrote them.

    Raises `InputError` if there are none, or they are damaged or of another acquisition.
    """
    acquisition, patterns = read_acquisition(folder)
    return load_counts(Path(folder) / "counts.npz", acquisition, patterns.manifest)


def load_counts(path: Path, acquisition: Acquisition, manifest: Manifest) -> Counts:
    """Counts of an acquisition of a manifest's patterns. Parameters as of `Counts.save`."""
    content = read_limited(path, LARGEST_COUNTS, "make it with `deepfsi camera count`")
    damaged = InputError(
        f"{path} is not a whole file of counts: make it with `deepfsi camera count`"
    )
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            about = _About.model_validate_json(_member(archive, "about", "|u1", None).tobytes())
            if about.acquisition != acquisition.digest:
                raise InputError(
                    f"{path} is of another acquisition than acquisition.json: count again with "
                    "`deepfsi camera count`"
                )
            scenes, rails, masks = len(acquisition.scenes), manifest.rails, manifest.masks
            kinds: dict[str, tuple[str, tuple[int, ...]]] = {
                "counts": ("<i8", (scenes, about.repeats, rails, masks)),
                "valid": ("|b1", (scenes, about.repeats)),
                "gate_s": ("<f8", (len(manifest.shown),)),
                "on_rate": ("<f8", (scenes,)),
                "off_rate": ("<f8", (scenes,)),
                "dark_rate": ("<f8", (rails,)),
                "lengths_s": ("<f8", (rails, masks)),
            }
            arrays = {name: _member(archive, name, *kind) for name, kind in kinds.items()}
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
    """Settings with which a file was counted, and the hash of the acquisition that was."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    acquisition: str
    repeats: int = Field(ge=1, le=MOST_READOUTS)
    exposure_s: Positive
    settle_s: float = Field(ge=0, allow_inf_nan=False)
    faults: tuple[Fault, ...]


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
        shape = ((len(content) - NPY_HEADER) // kind.itemsize,)
    header = io.BytesIO()
    about = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(header, about)
    held = header.getvalue()
    if len(content) != len(held) + kind.itemsize * math.prod(shape) or not content.startswith(held):
        raise ValueError(name)
    return np.frombuffer(content, kind, offset=len(held)).reshape(shape).copy()
