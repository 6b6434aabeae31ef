"""Folder of patterns: rails of a design to binary frames, and back.

A folder holds `manifest.json`, `mirrors.npy` (mirrors ON in each cell of each mask's frame), the
design if it was given, the frames of all masks and sentinels (`frames`), and tables of their times
(`controllers`).
"""

import json
import math
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar, Self, get_args

import numpy as np

from deepfsi.base.errors import InputError, as_input_error, check_choice
from deepfsi.base.files import check_disk_space, check_unpacked, hash_file, new_folder, read_text
from deepfsi.base.numeric.arrays import npy_header
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import plural, time_text
from deepfsi.camera.device import LONGEST_PICTURE_S, Device
from deepfsi.camera.layout import DmdLayout, find_grid
from deepfsi.camera.names import LIGHT_LAWS, LightLawName
from deepfsi.hardware.patterns.controllers import check_tables, controller_tables
from deepfsi.hardware.patterns.frames import (
    AGAIN,
    FRAME_FORMATS,
    Format,
    Selection,
    make_frames,
    open_array,
    recount,
    unpack,
)
from deepfsi.hardware.patterns.manifest import (
    DESIGN_NAME,
    LEAST_DIMMED,
    MOST_FRAMES,
    SENTINELS,
    DesignRails,
    Manifest,
    MaskFrames,
    check_stored,
    hash_mirrors,
)

EVEN = 1e-9
"""Departure of a cell's aspect from 1 below which it is square."""


SHORTEST_GATE_S = 1e-15
"""Shortest gate, seconds."""

LONGEST_SETTLE_S = 1e4
"""Longest time before the first gate of a frame, seconds."""


@dataclass(frozen=True)
class _ExposureCost:
    """Shares of a pass in which nothing is counted."""

    sentinels: float  # frames for alignment, flux and dark
    settling: float  # starts of the masks' frames, while mirrors move
    idle: float

    @property
    def total(self) -> float:
        """Share of the clock in which no gate is open."""
        return self.sentinels + self.settling + self.idle


@dataclass(frozen=True)
class GatePlan:
    """Gates of the frames of a pass, as they are asked for, in seconds after each frame's start.

    With clicks, each gate of a mask's frame is cut in as many equal parts, in which a detector
    fires at most once. An all-ON or all-OFF frame then has as many parts of what is left of it
    between settling and the usual tolerance of markers.
    """

    settle_s: float  # time before the first gate of each frame
    length_s: np.ndarray  # duration of a gate of each mask's frame, (f,): share times exposure
    repeats: int  # R, gates that follow each other in every mask's frame
    clicks: int = 0  # parts of each gate
    click_width_s: np.ndarray = field(default_factory=lambda: np.zeros(0))
    click_exposures: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    @classmethod
    def of(
        cls,
        manifest: Manifest,
        exposure_s: float,
        settle_s: float | None = None,
        repeats: int | None = None,
    ) -> Self:
        """Gates of an exposure."""
        settle = manifest.device.settle_us * 1e-6 if settle_s is None else settle_s
        if not (math.isfinite(exposure_s) and exposure_s > 0):
            raise InputError(f"exposure {exposure_s!r} is not allowed: give seconds above 0")
        if not 0 <= settle <= LONGEST_SETTLE_S:
            raise InputError(
                f"settle time {settle!r} is not allowed: give 0 to {LONGEST_SETTLE_S:g} seconds"
            )
        length = manifest.shares * exposure_s
        if not (len(length) and length.min() > SHORTEST_GATE_S):
            raise InputError(
                f"an exposure of {time_text(exposure_s)} leaves a frame less than "
                f"{SHORTEST_GATE_S:g} s: give a longer one"
            )
        longest = manifest.longest_exposure_s(settle)
        fit = int(np.floor(longest / exposure_s * (1 + 1e-9)))
        if fit < 1:
            raise InputError(
                f"an exposure of {time_text(exposure_s)} does not fit these frames, whose mirrors "
                f"take {time_text(settle)} to settle: give at most {time_text(max(longest, 0))}, "
                "or export with a longer --exposure"
            )
        if repeats is not None and not 1 <= repeats <= fit:
            raise InputError(f"{repeats} repeats do not fit: give 1 to {fit}")
        return cls(settle, length, repeats or fit)

    def with_clicks(self, manifest: Manifest, number: int) -> Self:
        """Gates each cut in so many parts, in which a detector fires at most once."""
        left = manifest.picture_s - self.settle_s - manifest.usual_tolerance_s
        width = left / number
        width[manifest.shown] = self.length_s / number
        exposures = np.ones(len(width), np.int64)
        exposures[manifest.shown] = self.repeats
        return replace(self, clicks=number, click_width_s=width, click_exposures=exposures)

    @property
    def starts_s(self) -> np.ndarray:
        """Starts of the gates, shape (f, R)."""
        return self.settle_s + self.length_s[:, None] * np.arange(self.repeats)

    def cost(self, manifest: Manifest) -> _ExposureCost:
        """Shares of a pass in which no gate is open, by their causes."""
        masks = float(manifest.picture_s[manifest.shown].sum())
        settling = self.settle_s * len(manifest.shown)
        idle = masks - settling - self.repeats * float(self.length_s.sum())
        total = manifest.pass_s
        return _ExposureCost(
            sentinels=(total - masks) / total,
            settling=settling / total,
            idle=max(idle, 0.0) / total,
        )


@dataclass(frozen=True)
class Patterns:
    """Manifest and mirror counts of a folder of patterns."""

    DESIGN: ClassVar[str] = DESIGN_NAME
    """File of the design in a folder of patterns."""

    """File of the networks that choose its dwells."""

    manifest: Manifest  # device, and frames in the order in which they are shown
    on: np.ndarray

    @property
    def fractions(self) -> np.ndarray:
        """Share of each cell's mirrors that are ON, k / K, float64 (f, N)."""
        return self.on / self.manifest.grid.mirrors

    @property
    def rails(self) -> np.ndarray:
        """Realised rails, float64 (rails, m, N): share of each pixel's photons."""
        manifest = self.manifest
        lit = np.stack([self.fractions, 1 - self.fractions])
        rail, mask, column, arm = manifest.read
        out = np.zeros((manifest.rails, manifest.masks, self.on.shape[1]))
        out[rail, mask] = manifest.shares[column, None] * lit[arm, column]
        return out

    @property
    def realised(self) -> tuple[np.ndarray, tuple[int, ...], float]:
        """Rails, image shape and dimming, as `Design.as_shown` takes them."""
        return self.rails, self.manifest.image_shape, self.manifest.dimmed

    def as_dict(self) -> dict[str, Any]:
        """JSON types only: what is shown, for how long, and what it costs."""
        manifest = self.manifest
        device = manifest.device
        times = [frame.picture_us for frame in manifest.frames]
        gates = self._longest_gates
        return {
            "frames": len(manifest.frames),
            "mask_frames": len(manifest.shown),
            "mean_picture_s": float(manifest.picture_s[manifest.shown].mean()),
            "pass_s": manifest.pass_s,
            "longest_exposure_s": None if gates is None else self._longest_s,
            "uncounted": None if gates is None else asdict(gates.cost(manifest)),
            "dimmed": manifest.dimmed,
            "looks": manifest.looks.count if manifest.looks else 1,
            "load_s": device.load_us and device.load_us * 1e-6,
            "device": device.name,
            "cell": [manifest.grid.height, manifest.grid.width],
            "aspect": manifest.grid.aspect,
            "used": manifest.used,
            "layout": manifest.layout.model_dump(),
            "most_frames": device.patterns,
            "picture_us": [min(times), max(times)],
            "departures": manifest.departures,
        }

    def lines(self) -> Iterator[str]:
        """Say what is shown, for how long, what it costs, and whether the device can."""
        manifest = self.manifest
        device = manifest.device
        times = [frame.picture_us for frame in manifest.frames]
        longest = f" to {device.longest_us}"
        if device.longest_us == LONGEST_PICTURE_S * 1e6:
            longest = " or more"
        yield from self._pass_lines()
        yield self._place_line
        yield (
            f"limits of {device.name}: {len(manifest.frames)} frames"
            f"{'' if device.patterns is None else f' of {device.patterns}'}, pictures of "
            f"{min(times)} to {max(times)} µs ({device.shortest_us}{longest} allowed)"
        )
        for departure in manifest.departures:
            yield f"beyond its documents: {departure}"
        if manifest.dimmed < LEAST_DIMMED:
            yield (
                f"cost in light: one device shows a {manifest.light} design with "
                f'{manifest.dimmed:.3g} of its light; learn it with `light="free-dwell"` or '
                "equal-dwell instead"
            )

    @property
    def _longest_s(self) -> float:
        """Longest exposure that the frames hold, seconds."""
        return self.manifest.longest_exposure_s(self.manifest.device.settle_us * 1e-6)

    @property
    def _longest_gates(self) -> GatePlan | None:
        """Gates of that exposure; None where masks are chosen while it runs."""
        if self.manifest.looks is not None:
            return None
        return GatePlan.of(self.manifest, self._longest_s)

    def _pass_lines(self) -> Iterator[str]:
        """Say the frames of a pass, its longest exposure and what it costs."""
        manifest = self.manifest
        device = manifest.device
        looks = manifest.looks
        frames = (
            f"{plural(len(manifest.shown), 'frame')} of masks and "
            f"{len(manifest.frames) - len(manifest.shown)} all-ON and all-OFF ones"
        )
        gates = self._longest_gates
        if looks and looks.dictionary:
            yield (
                f"{frames}: {plural(looks.count, 'look')}, each at one of these masks by its "
                "index, so that nothing is loaded between looks; show them with `deepfsi camera "
                "live`"
            )
            if device.packed:
                yield (
                    f"virtual devices alone show them: the driver of {device.name} shows its "
                    "table from the beginning, and no frame by its index"
                )
        elif looks:
            yield (
                f"{frames}: the mask of the first look, of {looks.count}; a live run loads a new "
                f"one before each look, {device.load_us} µs a frame on {device.name}, in which no "
                "photon is counted; show them with `deepfsi camera live`"
            )
        elif gates is not None:
            reason = f"no picture is shorter than {device.shortest_us} µs"
            if device.video_us:
                reason = "all pictures last as long as the longest"
            cost = gates.cost(manifest)
            yield (
                f"{frames}, {time_text(manifest.pass_s)} a pass, exposures up to "
                f"{time_text(self._longest_s)}"
            )
            yield (
                f"cost in time: at that exposure {cost.total:.1%} of a pass is not counted: "
                f"{cost.sentinels:.1%} for all-ON and all-OFF frames, {cost.settling:.1%} for "
                f"mirrors to settle, {cost.idle:.1%} since {reason}"
            )

    @property
    def _place_line(self) -> str:
        """Cells on the device, in words."""
        manifest = self.manifest
        device = manifest.device
        grid = manifest.grid
        layout = manifest.layout
        even = abs(grid.aspect - 1) < EVEN
        shape = "square" if even else f"{grid.aspect:.3g} times as wide as high"
        turned = [
            *(["flipped"] if layout.flip else []),
            *([f"turned by {layout.rotate} degrees clockwise"] if layout.rotate else []),
            *(["1 is OFF in the files"] if layout.invert else []),
        ]
        return (
            f"cells of {grid.width} x {grid.height} mirrors, {shape}, on "
            f"{grid.across * grid.width} x {grid.down * grid.height} of {device.columns} x "
            f"{device.rows} mirrors: {manifest.used:.1%} of the device's light is used"
            f"{''.join(f'; {words}' for words in turned)}"
        )


@dataclass(frozen=True)
class FrameSettings:
    """Settings of an export.

    Parameters
    ----------
    device
        Device that shows the frames.
    dwell_s
        Mean picture time of the masks' frames, seconds.
    selection, seed
        Choice of the mirrors of a grey cell, and where they are drawn from.
    format
        Files of the frames.
    layout
        How the cells lie on the device.

    Raises
    ------
    InputError
        If a setting is not allowed, or the device takes no such files.
    """

    device: Device
    dwell_s: float
    selection: Selection = "ordered"
    seed: int = 0
    format: Format = "npy"
    layout: DmdLayout = field(default_factory=DmdLayout)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.dwell_s) and 0 < self.dwell_s <= LONGEST_PICTURE_S):
            raise InputError(
                f"dwell {self.dwell_s!r} is not allowed: give seconds above 0, up to "
                f"{LONGEST_PICTURE_S:g}"
            )
        check_choice("selection", self.selection, get_args(Selection))
        if self.seed < 0:
            raise InputError(f"seed {self.seed} is not allowed: give 0 or more")
        check_choice("format", self.format, get_args(Format))
        if self.format == "planes" and not self.device.packed:
            raise InputError(
                f"{self.device.name} takes no pictures of 24 bit-planes: use format "
                "npy, raw, png or bmp"
            )

    @property
    def raised(self) -> bool:
        """True where the dwell is below the device's shortest picture time, which then holds."""
        return self.dwell_s * 1e6 < self.device.shortest_us * (1 - 1e-9)

    def times_us(self, shares: np.ndarray, light: LightLawName) -> tuple[list[int], int]:
        """Picture times of the masks' frames and of a sentinel, µs: one for all in a video."""
        # Under `equal-dwell` all frames last the mean time. Otherwise what a picture lasts beyond
        # the time to settle is in proportion to its share (f,) of the exposure. Times are rounded
        # up to whole microseconds and to the device's shortest
        device = self.device
        mean = max(self.dwell_s * 1e6, device.shortest_us)
        rest = mean - device.settle_us
        if rest <= 0:
            raise InputError(
                f"pictures of {mean:g} µs leave no time after the {device.settle_us:g} µs in which "
                "mirrors settle: give a longer --exposure"
            )
        wanted = device.settle_us + rest * len(shares) * shares / shares.sum()
        if LIGHT_LAWS[light].equal_times:
            wanted = np.full(len(shares), mean)
        elif wanted.max() > device.longest_us:
            raise InputError(
                f"with pictures of {time_text(self.dwell_s)} in the mean the longest picture takes "
                f"{time_text(wanted.max() / 1e6)}, and {device.name} allows "
                f"{time_text(device.longest_us / 1e6)}: give a shorter --exposure"
            )
        pictures = [max(device.shortest_us, _round_up(us)) for us in wanted.tolist()]
        sentinel = max(device.shortest_us, _round_up(self.dwell_s * 1e6))
        if not device.video_us:
            return pictures, sentinel
        total = len(shares) + SENTINELS
        together = device.packed_frames(total)
        one = max(*pictures, sentinel, -(-device.video_us // together))
        if one > device.longest_us:
            raise InputError(
                f"{total} frames, {together} in each picture of the video, would last {one} µs "
                f"each, and {device.name} shows {device.longest_us} at most: give a shorter "
                f"--exposure, or masks that make with {SENTINELS} sentinels a multiple of more "
                "frames"
            )
        return [one] * len(pictures), one

    def plan(self, design: DesignRails) -> Patterns:
        """Patterns of a design as an export would write them, whose frames have no hashes yet.

        `InputError` if the design is dark, or the device cannot show its frames.
        """
        device = self.device
        grid = find_grid(device, design.image_shape, self.layout)
        counted = MaskFrames.of(design, grid.mirrors)
        if not counted.mask_rails:
            raise InputError("every mask is dark, so there is nothing to show: give a lit design")
        total = len(counted.mask_rails) + SENTINELS
        if total > MOST_FRAMES:
            raise InputError(f"{total} frames are too many: give at most {MOST_FRAMES}")
        check_stored(device, total, design.looks)
        pictures_us, sentinel_us = self.times_us(
            design.first_dwells(counted), "free-dwell" if design.looks else design.light
        )
        manifest = Manifest.of(
            design,
            counted,
            pictures_us=pictures_us,
            sentinel_us=sentinel_us,
            hashes=["0" * 64] * total,
            device=device,
            selection=self.selection,
            seed=self.seed,
            format=self.format,
            layout=self.layout,
        )
        manifest.check_limits()
        return Patterns(manifest, counted.on)


def _round_up(us: float) -> int:
    """Number rounded up, but for what floating point adds."""
    return math.ceil(round(us, 6))


def export_patterns(
    design: DesignRails,
    settings: FrameSettings,
    folder: str | os.PathLike[str],
    progress: Progress = SILENT,
) -> Patterns:
    """Write what a device shows for a design, frame by frame, into a new folder.

    Where the shares of the exposure would sum to more than 1 (`column`), all are dimmed by the
    common factor `manifest.dimmed`.

    Parameters
    ----------
    design
        Rails to be shown.
    settings
        Device, times, files and layout.
    folder
        New folder.
    progress
        Told how many frames are written.

    Returns
    -------
    Patterns
        What was written.

    Raises
    ------
    InputError
        If the design is dark, or the device cannot show its frames; nothing is then written.
    """
    planned = settings.plan(design)
    device = settings.device
    grid = planned.manifest.grid
    on = planned.on
    total = len(planned.manifest.frames)
    files = FRAME_FORMATS[settings.format]
    check_disk_space(folder, files.size(total, device), 'write `format="png"`, which is small')
    ends = np.full_like(on[0], grid.mirrors), np.zeros_like(on[0])
    frames = make_frames(
        chain(ends, on, ends),
        device,
        grid,
        selection=settings.selection,
        seed=settings.seed,
    )
    hashes: list[str] = []

    def hashed() -> Iterator[np.ndarray]:
        for frame in frames:
            hashes.append(sha256(frame.data).hexdigest())
            yield frame
            progress(len(hashes) / total)

    with new_folder(folder) as draft:
        files.write(draft, hashed(), total, device)
        written = zip(planned.manifest.frames, hashes, strict=True)
        shown = tuple(frame.model_copy(update={"sha256": digest}) for frame, digest in written)
        manifest = planned.manifest.model_copy(update={"frames": shown})
        digest = _digest(manifest.model_dump_json())
        manifest = manifest.model_copy(update={"sha256": digest})
        mirrors = np.ascontiguousarray(on, "<u4")
        with (draft / "mirrors.npy").open("wb") as file:  # numpy.save loses what a disk cannot take
            file.write(npy_header("<u4", mirrors.shape))
            file.write(mirrors.data)
        tables = controller_tables(manifest)
        contents = {
            Patterns.DESIGN: design.file,
            "manifest.json": manifest.model_dump_json(indent=1).encode(),
            **{name: table.encode() for name, table in tables.items()},
        }
        for name, content in contents.items():
            if content is not None:
                (draft / name).write_bytes(content)
    return Patterns(manifest, on)


def read_patterns(folder: str | os.PathLike[str]) -> Patterns:
    """Read the patterns of a folder, without its frames; `InputError` if they were changed."""
    path = Path(folder) / "manifest.json"
    content = read_text(path, 2**29, "make patterns with `deepfsi dmd export`")
    with as_input_error(str(path), AGAIN, content):
        manifest = Manifest.model_validate_json(content)
    if manifest.sha256 not in (None, _digest(content)):
        raise InputError(
            f"{path} was changed after it was written: export the patterns again, or remove its "
            "sha256 to use it as it is"
        )
    shape = (len(manifest.shown), math.prod(manifest.image_shape))
    counts = Path(folder) / "mirrors.npy"
    with open_array(counts, "<u4", shape, first=int(manifest.shown[0])) as file:
        on = np.frombuffer(file.read(4 * math.prod(shape)), "<u4").reshape(shape)
    numbers = manifest.rails * manifest.masks * on.shape[1]
    check_unpacked(numbers, on.nbytes, f"the masks of {path}", AGAIN)
    if on.max(initial=0) > manifest.grid.mirrors:
        raise InputError(
            f"{counts} has cells with more than their {manifest.grid.mirrors} mirrors: {AGAIN}"
        )
    if hash_mirrors(on) != manifest.mirrors_sha256:
        raise InputError(
            f"{counts} was changed after it was written: export the patterns again, or copy it "
            "from the patterns that were shown"
        )
    return Patterns(manifest, on.astype(np.uint32, copy=False))


def read_frames(folder: str | os.PathLike[str]) -> Iterator[np.ndarray]:
    """Read the packed frames of a folder in their order: uint8 (rows, bytes of a row) each."""
    folder = Path(folder)
    yield from _load_frames(folder, read_patterns(folder).manifest)


def _load_frames(folder: Path, manifest: Manifest) -> Iterator[np.ndarray]:
    """Packed frames of a folder in their order, each compared with its hash."""
    total = len(manifest.frames)
    frames = FRAME_FORMATS[manifest.format].read(folder, total, manifest.device)
    for index, (packed, frame) in enumerate(zip(frames, manifest.frames, strict=True)):
        if sha256(packed.data).hexdigest() != frame.sha256:
            raise InputError(
                f"frame {index} of {folder} ({frame}) is not what was exported: {AGAIN}"
            )
        yield packed


def check_patterns(folder: str | os.PathLike[str], progress: Progress = SILENT) -> Patterns:
    """Read every frame of a folder and compare it with the manifest and the mirror counts."""
    folder = Path(folder)
    patterns = read_patterns(folder)
    manifest = patterns.manifest
    grid = manifest.grid
    manifest.check_limits()
    masks = iter(patterns.on)
    for index, packed in enumerate(_load_frames(folder, manifest)):
        frame = manifest.frames[index]
        wanted = next(masks) if frame.role == "mask" else grid.mirrors * (frame.role == "on")
        lit = unpack(packed, manifest.device) ^ manifest.layout.invert
        on = recount(lit, grid)
        if (on != wanted).any() or np.count_nonzero(lit) != on.sum():
            raise InputError(
                f"frame {index} of {folder} ({frame}) does not show what manifest.json and "
                f"mirrors.npy say: {AGAIN}"
            )
        progress((index + 1) / len(manifest.frames))
    check_tables(folder, manifest)
    for name, digest in manifest.companions.items():
        if hash_file(folder / name) != digest:
            raise InputError(f"{folder / name} is not the one that was exported: {AGAIN}")
    return patterns


def _digest(manifest: str | bytes) -> str:
    """Hash of a manifest's JSON but for the hash itself, whatever its layout."""
    content = {key: value for key, value in json.loads(manifest).items() if key != "sha256"}
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
