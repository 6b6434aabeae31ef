"""Folder of patterns: rails of a design to binary frames, and back.

manifest.json        device and frames (`Manifest`)
mirrors.npy          mirrors ON in each cell of each mask's frame
design.safetensors   the design, if any
frames.npy, …        frames of all masks and sentinels, in the format of the export (`frames`)
patterns.csv         the frames in the order in which they are shown, for those who load them
"""

import csv
import io
import json
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, Self

import numpy as np

from deepfsi.base.arrays import npy_header, read_npy
from deepfsi.base.errors import InputError, as_input_error, check_choice
from deepfsi.base.files import (
    check_unpacked,
    hash_file,
    new_folder,
    read_text,
)
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import plural, time_text
from deepfsi.camera.device import LONGEST_PICTURE_US, Device
from deepfsi.camera.layout import USUAL_LAYOUT, DmdLayout, find_grid
from deepfsi.camera.names import LIGHT_LAWS, LightLawName
from deepfsi.patterns.frames import (
    AGAIN,
    FRAME_FORMATS,
    Format,
    make_frames,
)
from deepfsi.patterns.manifest import SENTINELS, Manifest
from deepfsi.patterns.rails import LEAST_DIMMED, DesignRails


@dataclass(frozen=True)
class Patterns:
    """Frames for a device: their manifest, and the mirrors ON in each cell."""

    DESIGN: ClassVar[str] = "design.safetensors"
    """File of the design in a folder of patterns."""

    manifest: Manifest
    on: np.ndarray  # uint32 (f, N): mirrors ON in each cell of each mask's frame
    folder: Path | None = None  # that holds them
    design: bytes | None = None  # content of the design file that is written beside them

    @classmethod
    def from_rails(
        cls,
        rails: DesignRails,
        device: Device,
        dwell_s: float,
        *,
        format: Format = "npy",
        layout: DmdLayout = USUAL_LAYOUT,
    ) -> Self:
        """Patterns that show rails on a device, for `dwell_s` a frame in the mean; not written yet.

        Where the shares of the exposure would sum to more than 1 (`column`), all are dimmed by the
        common factor `manifest.dimmed`.
        """
        if not 0 < dwell_s <= LONGEST_PICTURE_US / 1e6:
            raise InputError(
                f"dwell {dwell_s!r} is not allowed: give seconds above 0, up to "
                f"{LONGEST_PICTURE_US / 1e6:g}"
            )
        check_choice("format", format, tuple(FRAME_FORMATS))
        if format == "planes" and not device.packed:
            raise InputError(
                f"{device.name} takes no pictures of 24 bit-planes: use format npy, raw or bmp"
            )
        frames = rails.in_mirrors(find_grid(device, rails.image_shape, layout).mirrors)
        if not frames.mask_rails:
            raise InputError("every mask is dark, so there is nothing to show: give a lit design")
        dwells = frames.shares
        if rails.looks is not None:
            dwells = np.array(rails.looks.first)[[mask for mask, _ in frames.mask_rails]]
        light = rails.light if rails.looks is None else "free-dwell"
        pictures_us, sentinel_us = _times_us(device, dwell_s, dwells, light)
        manifest = rails.manifest(
            frames,
            pictures_us=pictures_us,
            sentinel_us=sentinel_us,
            looks=rails.looks,
            device=device,
            format=format,
            layout=layout,
        )
        manifest.check_limits()
        return cls(manifest, frames.on, design=rails.file)

    def write(self, folder: str | os.PathLike[str], progress: Progress = SILENT) -> Self:
        """Write the frames into a new folder, all or none; gives the patterns with their hashes."""
        with new_folder(folder) as draft:
            return replace(self.fill(draft, progress), folder=Path(folder))

    def fill(self, folder: Path, progress: Progress = SILENT) -> Self:
        """Write the frames into an empty folder; gives the patterns with their hashes."""
        manifest = self.manifest
        total = len(manifest.frames)
        hashes: list[str] = []

        # hashes are taken while frames are written, so that frames are made once
        def hashed() -> Iterator[np.ndarray]:
            for frame in self.frames():
                hashes.append(sha256(frame.data).hexdigest())
                yield frame
                progress(len(hashes) / total)

        FRAME_FORMATS[manifest.format].write(folder, hashed(), total, manifest.device)
        shown = tuple(
            frame.model_copy(update={"sha256": digest})
            for frame, digest in zip(manifest.frames, hashes, strict=True)
        )
        manifest = manifest.model_copy(update={"frames": shown})
        digest = _digest(manifest.model_dump_json())
        manifest = manifest.model_copy(update={"sha256": digest})
        mirrors = np.ascontiguousarray(self.on, "<u4")
        # numpy.save loses what a disk cannot take
        with (folder / "mirrors.npy").open("wb") as file:
            file.write(npy_header("<u4", mirrors.shape))
            file.write(mirrors.data)
        if self.design is not None:
            (folder / self.DESIGN).write_bytes(self.design)
        (folder / "manifest.json").write_bytes(manifest.model_dump_json(indent=1).encode())
        (folder / "patterns.csv").write_bytes(_table(manifest).encode())
        return replace(self, manifest=manifest, folder=folder)

    @classmethod
    def read(cls, folder: str | os.PathLike[str]) -> Self:
        """Read the patterns of a folder, without its frames."""
        path = Path(folder) / "manifest.json"
        content = read_text(path, 2**29, "make patterns with `deepfsi dmd export`")
        with as_input_error(str(path), AGAIN):
            manifest = Manifest.model_validate_json(content)
        if manifest.sha256 not in (None, _digest(content)):
            raise InputError(
                f"{path} was changed after it was written: export the patterns again, or remove "
                "its sha256 to use it as it is"
            )
        shape = (len(manifest.mask_frames), math.prod(manifest.image_shape))
        counts = Path(folder) / "mirrors.npy"
        on = read_npy(counts)
        stored = np.ascontiguousarray(on, "<u4")
        if (
            on.shape != shape
            or on.dtype != np.uint32
            or sha256(stored.data).hexdigest() != manifest.mirrors_sha256
        ):
            raise InputError(
                f"{counts} was changed after it was written: export the patterns again, or copy it "
                "from the patterns that were shown"
            )
        # a small manifest can ask for rails far larger than its files
        numbers = manifest.rails * manifest.masks * on.shape[1]
        check_unpacked(numbers, on.nbytes, f"the masks of {path}", AGAIN)
        return cls(manifest, on, Path(folder))

    def frames(self) -> Iterator[np.ndarray]:
        """Packed frames, uint8 (rows, bytes of a row), in the order in which they are shown."""
        manifest = self.manifest
        if manifest.selection == "random" or manifest.format not in FRAME_FORMATS:
            raise InputError(f"{self.folder} has frames of an earlier version: {AGAIN}")
        grid = manifest.grid
        masks = iter(self.on)
        ends = {"on": np.full_like(self.on[0], grid.mirrors), "off": np.zeros_like(self.on[0])}
        shown = (
            next(masks) if frame.role == "mask" else ends[frame.role] for frame in manifest.frames
        )
        return make_frames(shown, manifest.device, grid)

    def check(self, progress: Progress = SILENT) -> Self:
        """Write the frames anew from the mirrors, and compare every file of the folder."""
        folder = self.folder
        assert folder is not None
        self.manifest.check_limits()
        with TemporaryDirectory() as temporary:
            anew = Path(temporary) / "anew"
            self.write(anew, progress)
            (anew / "manifest.json").unlink()  # `read` checks it
            for path in sorted(anew.rglob("*.*")):
                stored = folder / path.relative_to(anew)
                if hash_file(stored) != hash_file(path):
                    raise InputError(f"{stored} is not what was exported: {AGAIN}")
        design = folder / self.DESIGN
        if self.manifest.design_sha256 and hash_file(design) != self.manifest.design_sha256:
            raise InputError(f"{design} is not the one that was exported: {AGAIN}")
        return self

    @property
    def fractions(self) -> np.ndarray:
        """Share of each cell's mirrors that are ON, k / K, float64 (f, N)."""
        return self.on / self.manifest.grid.mirrors

    @property
    def rails(self) -> np.ndarray:
        """Realised rails, float64 (rails, m, N): share of each pixel's photons."""
        manifest = self.manifest
        lit = np.stack([self.fractions, 1 - self.fractions])
        rail, mask, column, arm = manifest.readout_table
        out = np.zeros((manifest.rails, manifest.masks, self.on.shape[1]))
        out[rail, mask] = manifest.shares[column, None] * lit[arm, column]
        return out

    @property
    def realised(self) -> tuple[np.ndarray, tuple[int, ...], float]:
        """Rails, image shape and dimming, as `Design.as_shown` takes them."""
        return self.rails, self.manifest.image_shape, self.manifest.dimmed

    def as_dict(self) -> dict[str, Any]:
        """JSON types only: the frames, and their times."""
        manifest = self.manifest
        device = manifest.device
        times = [frame.picture_us for frame in manifest.frames]
        return {
            "frames": len(manifest.frames),
            "mask_frames": len(manifest.mask_frames),
            "mean_picture_s": float(manifest.picture_s[manifest.mask_frames].mean()),
            "pass_s": manifest.pass_s,
            "longest_exposure_s": None if manifest.looks else self._longest_s,
            "dimmed": manifest.dimmed,
            "looks": manifest.looks.count if manifest.looks else 1,
            "load_s": device.load_us and device.load_us * 1e-6,
            "device": device.name,
            "cell": [manifest.grid.height, manifest.grid.width],
            "layout": manifest.layout.model_dump(),
            "most_frames": device.patterns,
            "picture_us": [min(times), max(times)],
        }

    def lines(self) -> Iterator[str]:
        """Say the frames, and their times."""
        manifest = self.manifest
        device = manifest.device
        grid = manifest.grid
        looks = manifest.looks
        frames = (
            f"{plural(len(manifest.mask_frames), 'frame')} of masks and "
            f"{len(manifest.frames) - len(manifest.mask_frames)} all-ON and all-OFF ones"
        )
        if looks is None:
            yield (
                f"{frames}, {time_text(manifest.pass_s)} a pass, exposures up to "
                f"{time_text(self._longest_s)}"
            )
        else:
            loaded = f"a mask that is loaded before it, {device.load_us} µs each"
            shown = "one of these masks by its index" if looks.dictionary else loaded
            yield (
                f"{frames}: {plural(looks.count, 'look')}, each at {shown}; show them with "
                "`deepfsi camera live`"
            )
        yield (
            f"cells of {grid.width} x {grid.height} mirrors on {grid.across * grid.width} x "
            f"{grid.down * grid.height} of {device.columns} x {device.rows} mirrors"
        )
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


def _times_us(
    device: Device, dwell_s: float, shares: np.ndarray, light: LightLawName
) -> tuple[list[int], int]:
    """Picture times of the masks' frames and of a sentinel, µs; a video has one time for all."""
    # Under `equal-dwell` all frames last the mean time. Otherwise the time of a picture after
    # settling is in proportion to its share (f,) of the exposure
    mean = max(dwell_s * 1e6, device.shortest_us)
    rest = mean - device.settle_us
    if rest <= 0:
        raise InputError(
            f"pictures of {mean:g} µs leave no time after the {device.settle_us:g} µs in which "
            "mirrors settle: give a longer --exposure"
        )
    wanted = device.settle_us + rest * len(shares) * shares / shares.sum()
    if LIGHT_LAWS[light].equal_times:
        wanted = np.full(len(shares), mean)
    pictures = [device.whole_us(us) for us in wanted.tolist()]
    sentinel = device.whole_us(dwell_s * 1e6)
    if not device.video_us:
        return pictures, sentinel
    total = len(shares) + SENTINELS
    together = device.packed_frames(total)
    # a video frame holds `together` pictures, and lasts its shortest time or longer
    picture_us = max(*pictures, sentinel, -(-device.video_us // together))
    if picture_us > device.longest_us:
        raise InputError(
            f"{total} frames, {together} in each picture of the video, would last {picture_us} µs "
            f"each, and {device.name} shows {device.longest_us} at most: give a shorter "
            f"--exposure, or masks that make with {SENTINELS} sentinels a multiple of more "
            "frames"
        )
    return [picture_us] * len(pictures), picture_us


def _table(manifest: Manifest) -> str:
    """Content of patterns.csv, which tells other programs how to show the frames."""
    device = manifest.device
    # A controller of the DLPC347x family turns all mirrors OFF between frames, for the time in
    # which they settle; the others change from frame to frame
    dark = round(device.settle_us) if device.controller == "dlpc347x" else 0
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    heads = ("pattern", "image", "bit", "exposure_us", "dark_us", "trigger_out", "new_image")
    rows.writerow([*heads, "shows", "settle_us"])
    form = FRAME_FORMATS[manifest.format]
    for index, frame in enumerate(manifest.frames):
        image, bit = form.location(index, len(manifest.frames), device)
        where = [index, image, "" if bit is None else bit]
        new_image = int(not bit)
        shown = [str(frame), f"{device.settle_us:g}"]
        rows.writerow([*where, frame.picture_us - dark, dark, 1, new_image, *shown])
    return out.getvalue()


def _digest(manifest: str | bytes) -> str:
    """Hash of a manifest's JSON without its own hash; white space does not matter."""
    content = {key: value for key, value in json.loads(manifest).items() if key != "sha256"}
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
