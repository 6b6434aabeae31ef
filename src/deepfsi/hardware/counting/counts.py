"""Photon counts of each readout, and their file counts.npz.

The file carries hashes of what was counted (settings, patterns, photons.ptu) and of its own
content: counts of something else, and counts that were edited, are refused.
"""

import dataclasses
import io
import math
import os
import struct
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, Self

import numpy as np
from pydantic import Field

from deepfsi.base.errors import InputError
from deepfsi.base.files import hash_file, read_regular, write_atomically
from deepfsi.base.models.strict import Amount, Count, Positive, StrictModel
from deepfsi.base.numeric.arrays import npy_header
from deepfsi.base.quantities import count_text, time_text
from deepfsi.camera.dead_time import NO_EFFECTS, CounterEffects
from deepfsi.hardware.counting.acquisition import (
    MOST_READOUTS,
    Run,
    read_run,
)
from deepfsi.hardware.light.checks import SPOILING, Fault
from deepfsi.hardware.photons.reader import PtuFile

LARGEST_COUNTS = 2**27
"""Bytes of counts.npz at most."""

LEAST_UNFIRED = 25
"""Gates of all ON without a click that tell the light, at least: to 1 / 5 of a photon in each."""


@dataclass(frozen=True)
class RunLight:
    """Light of each scene, as `Counts` has it, and the faults of all."""

    on_rate: np.ndarray  # (S,)
    off_rate: np.ndarray  # (S,)
    flux: np.ndarray  # (S,)
    dark_rate: np.ndarray  # (S, rails[, D])
    faults: tuple[Fault, ...] = ()


@dataclass(frozen=True)
class Counts:
    """Photon counts of each readout; the axis D is there only of several detectors."""

    counts: np.ndarray  # registered counts, int64, or the values of a table
    arrivals: np.ndarray
    variance: np.ndarray
    valid: np.ndarray  # whether all readouts of an exposure were recorded
    gate_s: np.ndarray  # for how long each mask's frame is counted, seconds
    on_rate: np.ndarray
    off_rate: np.ndarray
    flux: np.ndarray
    dark_rate: np.ndarray
    ambient: np.ndarray
    ambient_variance: np.ndarray
    exposure_s: float
    settle_s: float
    lengths_s: np.ndarray  # for how long each readout is counted, seconds
    drift: float  # by how much passes lasted longer than planned on the counter's clock, a share
    inputs: tuple[int, ...]  # of the counter, 0 for input 1: those whose photons were counted
    faults: tuple[Fault, ...]
    effects: CounterEffects = NO_EFFECTS  # for which the arrivals and all rates are corrected
    gains: tuple[float, ...] = ()  # relative efficiency of each detector, corrected too
    gates: int | None = None  # G of clicks, the first photons of the gates of a frame's exposure

    @property
    def background(self) -> np.ndarray:
        """Counts that each readout holds without the scene, float64 (S, rails, m[, D])."""
        if self.gates is not None:
            return np.zeros_like(self.counts[:, 0], float)  # clicks are read as they are
        lengths = np.expand_dims(self.lengths_s, tuple(range(2, self.dark_rate.ndim)))
        return self.dark_rate[:, :, None] * lengths + self.ambient

    def signal(self) -> np.ndarray:
        """Arrivals less the background, float64 (S, R, rails, m[, D])."""
        return self.arrivals - self.background[:, None] * self.by_readout(self.valid)

    @property
    def excess(self) -> np.ndarray:
        """Variance of the arrivals beyond Poisson's, 0 or more, float64 (S, R, rails, m[, D])."""
        return np.maximum(self.variance - np.maximum(self.arrivals, 0.0), 0.0)

    def by_readout(self, exposures: np.ndarray) -> np.ndarray:
        """Array (S, R) of exposures, with further axes so that it goes with `counts`."""
        return np.expand_dims(exposures, tuple(range(2, self.counts.ndim)))

    @property
    def photons(self) -> np.ndarray:
        """Budget Φ of an exposure of each scene (S,): flux times exposure."""
        # In counts: the detector's efficiency is part of it
        return self.flux * self.exposure_s

    def faults_of(self, scene: int) -> tuple[Fault, ...]:
        """Faults of a scene, and those of the whole recording."""
        return tuple(fault for fault in self.faults if fault.scene in (scene, None))

    @property
    def spoilt(self) -> np.ndarray:
        """Scenes (S,), bool, whose counts have no meaning: the light was not what it should be."""
        out = np.zeros(len(self.valid), bool)
        for fault in self.faults:
            if fault.kind in SPOILING:
                out[slice(None) if fault.scene is None else fault.scene] = True
        return out

    def check_photons(self, folder: str | os.PathLike[str]) -> Self:
        """Counts of photons as they are; `InputError` if they are clicks."""
        if self.gates is not None:
            raise InputError(
                f"{folder} was counted in clicks, which are not in proportion to the light: record "
                "it with the patterns of a design or a scan for photon counts"
            )
        return self

    def check_budget(self, source: str) -> None:
        """Raise `InputError` where clicks do not tell the flux of any scene."""
        if not np.isfinite(self.flux).any():
            raise InputError(
                f"{source} does not tell its budget: all-ON frames leave less than {LEAST_UNFIRED} "
                "gates without a click, or click no more often than all-OFF ones; give `photons`, "
                "or look at the order of frames"
            )

    def as_dict(self, run: Run) -> dict[str, Any]:
        """JSON types only, with the names of the scenes of the run that was counted."""
        names = [scene.name for scene in run.acquisition.scenes]
        faults = [
            fault.model_dump() | {"name": None if fault.scene is None else names[fault.scene]}
            for fault in self.faults
        ]
        return {
            "scenes": len(self.counts),
            "exposures": int(self.valid.size),
            "whole": int(self.valid.sum()),
            "exposure_s": self.exposure_s,
            "photons_counted": int(self.counts.sum()),
            "photons": [None if math.isnan(flux) else flux for flux in self.photons.tolist()],
            "dark_rate": self.dark_rate.tolist(),
            "drift": self.drift,
            "inputs": [number + 1 for number in self.inputs],
            "dead_time_s": self.effects.dead_time.seconds,
            "paralysable": self.effects.dead_time.paralysable,
            "arrivals": float(self.arrivals.sum()),
            "ambient": float(self.ambient.sum()),
            "gains": list(self.gains),
            "gates": self.gates,
            "problems": list(PtuFile(run.photons).problems),
            "faults": faults,
            "counts": self.counts.tolist(),
            "valid": self.valid.tolist(),
        }

    def lines(self, run: Run) -> Iterator[str]:
        """Say what of a run was counted, its faults, and what was corrected."""
        for problem in PtuFile(run.photons).problems:
            yield f"{run.photons.name}: {problem}"
        names = [scene.name for scene in run.acquisition.scenes]
        for fault in self.faults:
            yield fault.line(names)
        counted = int(self.counts.sum())
        if self.effects.dead_time.seconds:
            lost = 1 - counted / max(float(self.arrivals.sum()), 1.0)
            yield (
                f"dead time of {self.effects.dead_time}: {lost:.1%} of the photons were lost, and "
                "are added"
            )
        if self.gains:
            gains = ", ".join(f"{gain:.3f}" for gain in self.gains)
            yield f"efficiencies corrected: {gains}"
        kind = "photons" if self.gates is None else f"clicks of up to {self.gates} a frame"
        stated = self.gates is not None and run.acquisition.flux in self.flux
        source = "that acquisition.json states" if stated else "by the all-ON frames"
        yield (
            f"{len(self.counts)} scenes, {self.valid.size} exposures of "
            f"{time_text(self.exposure_s)}, {int(self.valid.sum())} of them whole"
        )
        yield f"{counted} {kind} counted"
        yield f"budget {source}: {_span(self.photons)} photons an exposure"
        yield f"dark counts: {_span(self.dark_rate[self.valid.any(axis=1)])} a second"
        yield f"clocks: frames last {_drift_text(self.drift)}"
        if self.ambient_variance.any():
            error = math.sqrt(self.ambient_variance.sum())
            yield (
                f"background subtracted: {self.ambient.sum():.4g} ± {error:.2g} counts an exposure"
            )
        yield f"counts: {run.folder / 'counts.npz'}"

    def save(self, run: Run) -> None:
        """Write counts.npz to the folder of the run that was counted."""
        fields = {**vars(self), **dict(self.effects)}
        del fields["effects"]
        arrays: dict[str, Any] = {
            name: value for name, value in fields.items() if isinstance(value, np.ndarray)
        }
        provenance = _Provenance(
            acquisition=run.acquisition.digest,
            photons_sha256=hash_file(run.photons),
            repeats=self.counts.shape[1],
            **{name: value for name, value in fields.items() if name not in arrays},
        )
        arrays["about"] = np.frombuffer(provenance.model_dump_json().encode(), np.uint8)
        file = io.BytesIO()
        np.savez(file, sha256=_hash_arrays(arrays), **arrays)
        write_atomically(run.folder / "counts.npz", file.getvalue())


def _span(values: np.ndarray) -> str:
    """Least and largest of the numbers among some."""
    if np.isnan(values).all():
        return "unknown"
    ends = [count_text(end) for end in (np.nanmin(values), np.nanmax(values))]
    return " to ".join(dict.fromkeys(ends))


def _drift_text(drift: float) -> str:
    """Drift of clocks, a share, in words."""
    # Drift of clocks that is said to be none, as a share
    if abs(drift) < 1e-7:
        return "as planned"
    # Drift of clocks that is said in ppm, as a share
    size = f"{abs(drift) * 1e6:.1f} ppm" if abs(drift) < 1e-3 else f"{abs(drift):.2%}"
    return f"{size} {'shorter' if drift < 0 else 'longer'} than planned"


def read_counts(run: str | os.PathLike[str] | Run) -> Counts:
    """Counts of a run, or of its folder, as `count_run` wrote them, or `InputError`."""
    if not isinstance(run, Run):
        run = read_run(run)
    acquisition = run.acquisition
    manifest = run.manifest
    acquisition.check_fixed(run.folder)
    path = run.folder / "counts.npz"
    content = read_regular(path, LARGEST_COUNTS, "make it with `deepfsi camera count`")
    again = "count again with `deepfsi camera count`"
    scenes = (len(acquisition.scenes),)
    masks = (manifest.rails, manifest.masks)
    several = manifest.several
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            text = _member(archive, "about", "|u1", None)
            provenance = _Provenance.model_validate_json(text.tobytes())
            if provenance.acquisition != acquisition.digest:
                raise InputError(f"{path} is of another acquisition than acquisition.json: {again}")
            exposures = (*scenes, provenance.repeats)
            readouts = (*exposures, *masks, *several)
            shapes = {
                **dict.fromkeys(("counts", "arrivals", "variance"), readouts),
                "valid": exposures,
                "gate_s": (len(manifest.shown),),
                **dict.fromkeys(("on_rate", "off_rate", "flux"), scenes),
                "dark_rate": (*scenes, manifest.rails, *several),
                **dict.fromkeys(("ambient", "ambient_variance"), (*masks, *several)),
                "lengths_s": masks,
            }
            kinds = {"counts": "<i8", "valid": "|b1"}
            arrays: dict[str, Any] = {
                name: _member(archive, name, kinds.get(name, "<f8"), shape)
                for name, shape in shapes.items()
            }
            digest = _member(archive, "sha256", "|u1", (sha256().digest_size,))
    except InputError:
        raise
    # What zipfile raises of damaged archives, and pydantic of what is in them
    except (
        zipfile.BadZipFile,
        KeyError,
        ValueError,
        OSError,
        EOFError,
        RuntimeError,
        struct.error,
    ):
        raise InputError(
            f"{path} is not a whole file of counts: make it with `deepfsi camera count`"
        ) from None
    if not np.array_equal(digest, _hash_arrays({**arrays, "about": text})):
        raise InputError(f"{path} was changed after it was written: {again}")
    if run.photons.is_file() and hash_file(run.photons) != provenance.photons_sha256:
        raise InputError(f"{path} is of another {run.photons.name} than the one beside it: {again}")
    fields = {field.name for field in dataclasses.fields(Counts)}
    settings = {name: value for name, value in provenance if name in fields}
    return Counts(**arrays, **settings, effects=provenance.effects)


def _hash_arrays(arrays: dict[str, np.ndarray]) -> np.ndarray:
    """Hash of named arrays, their types and shapes, uint8 (32,)."""
    digest = sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return np.frombuffer(digest.digest(), np.uint8)


class _Counting(StrictModel):
    """Times and inputs of a count, and hashes of the acquisition and its photons.ptu."""

    acquisition: str
    photons_sha256: str
    repeats: int = Field(ge=1, le=MOST_READOUTS)
    exposure_s: Positive
    settle_s: Amount
    drift: float
    inputs: tuple[int, ...]
    faults: tuple[Fault, ...]


class _Provenance(CounterEffects, _Counting):
    """Settings with which a file was counted, in the order in which it has them."""

    gains: tuple[Positive, ...] = ()
    gates: Count | None = None


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
        # Bytes of the header of a vector in numpy's format
        shape = ((len(content) - 128) // kind.itemsize,)
    header = npy_header(dtype, shape)
    if len(content) != len(header) + kind.itemsize * math.prod(shape) or not content.startswith(
        header
    ):
        raise ValueError(name)
    return np.frombuffer(content, kind, offset=len(header)).reshape(shape).copy()
