"""Folder of patterns: rails of a design to binary frames, and back.

A folder holds `manifest.json`, `mirrors.npy` (mirrors ON in each cell of each mask's frame), the
design if it was given, `loop.safetensors` of a design of several looks, the frames of all masks and
sentinels (`frame_files`), and tables of their times (`controller_tables`).
"""

import json
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from deepfsi.base import (
    SILENT,
    InputError,
    Progress,
    as_input_error,
    check_choice,
    check_disk_space,
    check_unpacked,
    hash_file,
    new_folder,
    read_text,
)
from deepfsi.camera import LIGHT_LAWS, DetectorMap, LightLawName, Readout, find_grid
from deepfsi.hardware.patterns import controller_tables, frame_files, mirrors, sequence
from deepfsi.hardware.patterns.limits import check_limits, check_stored
from deepfsi.hardware.patterns.looks import Looks

SENTINELS = 4
"""Frames of a pass that show no mask."""

DESIGN, LOOP = "design.safetensors", "loop.safetensors"
"""Files of the design, and of the networks that choose its dwells."""

LARGEST_MANIFEST = 2**29
"""Bytes of a manifest at most."""

ARMS_SLACK = 1e-4
"""Share of the exposure by which two arms' times may differ between pixels."""


@dataclass(frozen=True)
class DesignRails:
    """Rails of a design that are to be shown."""

    rails: np.ndarray  # (2 or 1, m, N)
    light: LightLawName
    image_shape: tuple[int, ...]
    summed_reflectance: float
    file: bytes | None = None
    brightness: sequence.Brightness | None = None
    detectors: DetectorMap | None = None
    readout: Readout = "difference"
    looks: Looks | None = None
    loop: bytes | None = None

    def __post_init__(self) -> None:
        rails = self.rails
        pixels = math.prod(self.image_shape) or rails.shape[-1]  # `find_grid` refuses none
        check_choice("light law", self.light, get_args(LightLawName))
        if rails.shape != (self.rail_count, *rails.shape[1:2], pixels) or not rails.size:
            raise InputError(
                f"rails of shape {rails.shape} are not allowed: give (2 or 1, masks, {pixels})"
            )
        if self.two_arm and self.rail_count != 2:
            raise InputError("two-arm with a single rail is not allowed: give both arms' rails")
        if not np.isfinite(rails).all() or rails.min() < 0:
            raise InputError(
                "rails must be finite and 0 or more: give shares of each pixel's photons"
            )
        times = rails.sum(axis=0)
        if self.two_arm and np.ptp(times, axis=-1).max() * len(times) > ARMS_SLACK:
            raise InputError("the two arms of a mask do not sum to one time for all of its pixels")
        if not (math.isfinite(self.summed_reflectance) and self.summed_reflectance > 0):
            raise InputError(
                f"summed reflectance {self.summed_reflectance!r} is not allowed: give a number "
                "above 0"
            )

    @property
    def two_arm(self) -> bool:
        """True where a second detector sees the mirrors that are OFF."""
        return LIGHT_LAWS[self.light].arms == 2

    @property
    def rail_count(self) -> Literal[1, 2]:
        """Number of rails: 2 of signed masks, or 1."""
        return 2 if len(self.rails) == 2 else 1

    def first_dwells(self, counted: mirrors.MaskFrames) -> np.ndarray:
        """Shares of the exposure (f,) for which a fixed sequence, or a first look, shows frames."""
        if self.looks is None:
            return counted.shares
        masks, rails = zip(*counted.shown, strict=True)
        places = self.looks.places(np.array(masks), np.array(rails) == "minus")
        return np.array(self.looks.first)[places]


def export_patterns(
    design: DesignRails,
    settings: sequence.FrameSettings,
    folder: str | os.PathLike[str],
    report: Progress = SILENT,
) -> sequence.Patterns:
    """Write what a device shows for a design, frame by frame, into a new folder."""
    # Where the shares of the exposure would sum to more than 1 (`column`), all are dimmed by the
    # common factor `manifest.dimmed`
    device = settings.device
    grid = find_grid(device, design.image_shape, settings.layout)
    counted = mirrors.count_mirrors(design.rails, design.light, grid.mirrors)
    if not counted.shown:
        raise InputError("every mask is dark, so there is nothing to show: give a lit design")
    total = len(counted.shown) + SENTINELS
    if total > sequence.MOST_FRAMES:
        raise InputError(f"{total} frames are too many: give at most {sequence.MOST_FRAMES}")
    check_stored(device, total)
    pictures, sentinel = settings.times_us(
        design.first_dwells(counted), "free-dwell" if design.looks else design.light, SENTINELS
    )
    ends = np.full_like(counted.on[0], grid.mirrors), np.zeros_like(counted.on[0])
    every = chain(ends, counted.on, ends)
    check_disk_space(
        folder, frame_files.size(total, settings), 'write `format="png"`, which is small'
    )
    with new_folder(folder) as draft:
        frames = mirrors.make_frames(every, device, grid, settings.selection, settings.seed)
        hashes = frame_files.write_frames(draft, frames, total, settings, report)
        manifest = list_frames(
            design,
            counted,
            (pictures, sentinel),
            hashes,
            device=device,
            selection=settings.selection,
            seed=settings.seed,
            format=settings.format,
            layout=settings.layout,
        )
        check_limits(manifest)
        return _write(draft, sequence.Patterns(manifest, counted.on), design)


def list_frames(
    design: DesignRails,
    counted: mirrors.MaskFrames,
    times_us: tuple[list[int], int],
    hashes: list[str],
    **settings: Any,
) -> sequence.Manifest:
    """Manifest of a design's frames in their order, from picture times of masks and a sentinel."""
    pictures_us, sentinel_us = times_us
    ends = (
        sequence.Frame(role="on", picture_us=sentinel_us, sha256=hashes[0]),
        sequence.Frame(role="off", picture_us=sentinel_us, sha256=hashes[1]),
    )
    shown = (
        sequence.Frame(role="mask", mask=mask, rail=rail, share=share, picture_us=us, sha256=digest)
        for (mask, rail), share, us, digest in zip(
            counted.shown, counted.shares.tolist(), pictures_us, hashes[2:-2], strict=True
        )
    )
    return sequence.Manifest(
        deepfsi=version("deepfsi"),
        image_shape=tuple(map(int, design.image_shape)),
        masks=design.rails.shape[1],
        rails=design.rail_count,
        light=design.light,
        dimmed=counted.dimmed,
        summed_reflectance=float(design.summed_reflectance),
        brightness=design.brightness,
        detectors=design.detectors,
        readout=design.readout,
        looks=design.looks,
        design_sha256=None if design.file is None else sha256(design.file).hexdigest(),
        mirrors_sha256=hash_mirrors(counted.on),
        frames=(*ends, *shown, *ends),
        **settings,
    )


def _write(folder: Path, patterns: sequence.Patterns, design: DesignRails) -> sequence.Patterns:
    """Write all files of a folder but the frames; the patterns with the manifest as written."""
    counts = np.ascontiguousarray(patterns.on, "<u4")
    with (folder / "mirrors.npy").open("wb") as file:  # numpy.save loses what a disk does not take
        file.write(frame_files.npy_header("<u4", counts.shape))
        file.write(counts.data)
    for name, content in ((DESIGN, design.file), (LOOP, design.loop)):
        if content is not None:
            (folder / name).write_bytes(content)
    digest = _digest(patterns.manifest.model_dump_json())
    manifest = patterns.manifest.model_copy(update={"sha256": digest})
    (folder / "manifest.json").write_bytes(manifest.model_dump_json(indent=1).encode())
    for name, table in controller_tables.tables(manifest).items():
        (folder / name).write_bytes(table.encode())
    return sequence.Patterns(manifest, patterns.on)


def read_patterns(folder: str | os.PathLike[str]) -> sequence.Patterns:
    """Patterns of a folder, without reading its frames."""
    path = Path(folder) / "manifest.json"
    content = read_text(path, LARGEST_MANIFEST, "make patterns with `deepfsi dmd export`")
    with as_input_error(str(path), "export the patterns again", content):
        manifest = sequence.Manifest.model_validate_json(content)
    if manifest.sha256 not in (None, _digest(content)):
        raise InputError(
            f"{path} was changed after it was written: export the patterns again, or remove its "
            "sha256 to use it as it is"
        )
    shape = (len(manifest.shown), math.prod(manifest.image_shape))
    counts = Path(folder) / "mirrors.npy"
    with frame_files.open_array(counts, "<u4", shape, first=int(manifest.shown[0])) as file:
        on = np.frombuffer(file.read(4 * math.prod(shape)), "<u4").reshape(shape)
    every, again = manifest.rails * manifest.masks * on.shape[1], "export the patterns again"
    check_unpacked(every, on.nbytes, f"the masks of {path}", again)
    if on.max(initial=0) > manifest.grid.mirrors:
        raise InputError(
            f"{counts} has cells with more than their {manifest.grid.mirrors} mirrors: export the "
            "patterns again"
        )
    if hash_mirrors(on) != manifest.mirrors_sha256:
        raise InputError(
            f"{counts} was changed after it was written: export the patterns again, or copy it "
            "from the patterns that were shown"
        )
    return sequence.Patterns(manifest, on.astype(np.uint32, copy=False))


def hash_mirrors(on: np.ndarray) -> str:
    """Hash of mirror counts (f, N), as a manifest holds it."""
    return sha256(np.ascontiguousarray(on, "<u4").data).hexdigest()


def read_frames(folder: str | os.PathLike[str]) -> Iterator[np.ndarray]:
    """Packed frames of a folder in their order, one at a time: uint8 (rows, bytes of a row)."""
    folder = Path(folder)
    yield from _load_frames(folder, read_patterns(folder).manifest)


def _load_frames(folder: Path, manifest: sequence.Manifest) -> Iterator[np.ndarray]:
    """Packed frames of a folder in their order, each compared with its hash."""
    for place, packed in enumerate(frame_files.load_frames(folder, manifest)):
        frame = manifest.frames[place]
        if sha256(packed.data).hexdigest() != frame.sha256:
            raise InputError(
                f"frame {place} of {folder} ({frame}) is not what was exported: export the "
                "patterns again"
            )
        yield packed


def check_patterns(folder: str | os.PathLike[str], report: Progress = SILENT) -> sequence.Patterns:
    """Read every frame of a folder and compare it with the manifest and the mirror counts."""
    folder = Path(folder)
    patterns = read_patterns(folder)
    manifest, grid = patterns.manifest, patterns.manifest.grid
    check_limits(manifest)
    masks = iter(patterns.on)
    for place, packed in enumerate(_load_frames(folder, manifest)):
        frame = manifest.frames[place]
        name = f"frame {place} of {folder} ({frame})"
        wanted = next(masks) if frame.role == "mask" else grid.mirrors * (frame.role == "on")
        lit = mirrors.unpack(packed, manifest.device) ^ manifest.layout.invert
        on = mirrors.recount(lit, grid)
        if (on != wanted).any() or np.count_nonzero(lit) != on.sum():
            raise InputError(
                f"{name} does not show what manifest.json and mirrors.npy say: export the "
                "patterns again"
            )
        report((place + 1) / len(manifest.frames))
    controller_tables.check_tables(folder, manifest)
    for name, digest in companions(manifest).items():
        if hash_file(folder / name) != digest:
            raise InputError(
                f"{folder / name} is not the one that was exported: export the patterns again"
            )
    return patterns


def companions(manifest: sequence.Manifest) -> dict[str, str]:
    """Files beside a manifest that say what was shown, by their hashes."""
    looks = manifest.looks
    known = {DESIGN: manifest.design_sha256, LOOP: None if looks is None else looks.loop_sha256}
    return {name: digest for name, digest in known.items() if digest is not None}


def _digest(manifest: str | bytes) -> str:
    """Hash of a manifest's JSON but for the hash itself, whatever its layout."""
    content = {key: value for key, value in json.loads(manifest).items() if key != "sha256"}
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
