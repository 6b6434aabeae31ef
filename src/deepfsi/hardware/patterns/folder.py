"""Patterns for a micromirror device: rails of a design to binary frames in a folder, and back.

A cell's grey level is the number `k` of its `K` mirrors that are ON, exact in both selections.
`ordered` takes the first k of a fixed order in which every beginning is spread evenly over the
cell, so that k/K of the light is taken even where a scene varies within a cell; `random` takes any
k, drawn anew for each cell of each frame.

Bits are packed along rows, the leftmost mirror in the highest bit of a byte, ON as 1; each row
begins a new byte. A folder holds `manifest.json`, `mirrors.npy` (mirrors ON in each cell of each
mask's frame), the design if it was given, and the frames of all masks and sentinels as

    npy    frames.npy, uint8 (frames, rows, bytes of a row)
    png    frames/0000.png ..., one bit a pixel, ON white
    raw    frames.bin, the same bytes as frames.npy without its header, top row first
"""

import hashlib
import io
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from PIL import Image, PngImagePlugin

from deepfsi.errors import InputError, as_input_error, closest
from deepfsi.files import new_folder
from deepfsi.hardware.patterns.gates import find_gates
from deepfsi.hardware.patterns.sequence import (
    MOST_FRAMES,
    Device,
    Frame,
    Grid,
    Manifest,
    Patterns,
    Rail,
    find_grid,
)

Selection = Literal["ordered", "random"]
Format = Literal["npy", "png", "raw"]

LIGHTS = ("column", "equal-dwell", "free-dwell", "two-arm")
SIDES: tuple[Rail, Rail] = ("plus", "minus")
STREAMS = {"npy": "frames.npy", "raw": "frames.bin"}
FORMATS = (*STREAMS, "png")

SLACK = 1e-4
"""Share of the exposure by which two arms' times may differ between pixels."""

TINY = float(np.finfo(np.float64).tiny)
"""A rail whose peak is fewer of these than a cell has mirrors is dark."""

MOST_TILE_BYTES = 2**24
"""Largest table of every grey level of a cell, packed; larger ones are not worth their memory."""

HERD = 2**12
"""Most mirrors of a cell that are put in order one by one: the time grows with the square."""

SPREAD = 0.3
"""Length over which mirrors repel each other, in sides of a cell."""

LONGEST_S = 1e3
"""Longest picture, seconds."""

UNIT = 2**15
"""Of the repelling potential in each direction."""


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
        hashes = _write_frames(draft, format, device, len(shown) + 4, every, progress)
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


def count_mirrors(
    rails: np.ndarray, light: str, mirrors: int
) -> tuple[list[tuple[int, Rail]], np.ndarray, np.ndarray]:
    """Frames that show rails, mask by mask, dark ones left out.

    Parameters
    ----------
    rails : array, shape (2 or 1, m, N)
    light : str
    mirrors : int
        K, mirrors of a cell.

    Returns
    -------
    shown : list of (mask, rail)
    peaks : array, shape (f,)
        float64; on two arms the time of the mask.
    on : array, shape (f, N)
        uint32; mirrors ON in each cell, 0 to K: the rail over its peak in steps of 1/K.
    """
    shown: list[tuple[int, Rail]] = []
    peaks = []
    on = np.empty((rails.shape[0] * rails.shape[1], rails.shape[2]), dtype=np.uint32)
    for mask in range(rails.shape[1]):
        parts = rails[:, mask].astype(np.float64)
        sides: list[tuple[Rail, float, np.ndarray]] = []
        if light == "two-arm":
            time = parts.sum(axis=0)
            sides.append(("both", time.max(), parts[0] / np.where(time > 0, time, 1.0) * mirrors))
        else:
            for rail, part in zip(SIDES, parts, strict=False):
                step = max(part.max() / mirrors, TINY)
                sides.append((rail, part.max(), part / step))
        for rail, peak, level in sides:
            if peak > mirrors * TINY:
                on[len(shown)] = np.rint(level)
                shown.append((mask, rail))
                peaks.append(peak)
    return shown, np.array(peaks), on[: len(shown)]


def make_frames(
    on: Iterable[np.ndarray],
    device: Device,
    grid: Grid,
    selection: Selection = "ordered",
    seed: int = 0,
) -> Iterator[np.ndarray]:
    """Packed frames, one at a time.

    Parameters
    ----------
    on : iterable of array, shape (N,)
        Mirrors ON in each cell.
    device : Device
    grid : Grid
    selection : {"ordered", "random"}
    seed : int
        For `random`.

    Yields
    ------
    array, shape (rows, bytes of a row)
        uint8; mirrors outside the grid are OFF. A new array each.
    """
    if selection == "random":
        yield from _draw(on, device, grid, np.random.default_rng(seed))
    elif _aligned(device, grid):
        yield from _look_up(on, device, grid)
    else:
        yield from _compare(on, device, grid)


def unpack(frame: np.ndarray, device: Device) -> np.ndarray:
    """Mirrors of a packed frame, bool (rows, columns), True where ON."""
    return np.unpackbits(frame, axis=1, count=device.columns).view(np.bool_)


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
    with _array(counts, "<u4", shape, first=int(manifest.shown[0])) as file:
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
    yield from _frames(Path(folder), read_patterns(folder).manifest)


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
    for place, frame in enumerate(_frames(folder, manifest)):
        known = manifest.frames[place]
        name = f"frame {place} of {folder} ({describe(known)})"
        if hashlib.sha256(frame.data).hexdigest() != known.sha256:
            raise InputError(f"{name} is not what was exported: export the patterns again")
        mirrors = unpack(frame, manifest.device)
        if known.role == "mask":
            same = np.array_equal(recount(mirrors, grid), next(rows))
        else:
            same = np.array_equal(mirrors, _sentinel(manifest.device, grid, known.role == "on"))
        if not same:
            raise InputError(
                f"{name} does not show what manifest.json and mirrors.npy say: export the "
                "patterns again"
            )
        if progress is not None:
            progress((place + 1) / total)
    if manifest.design_sha256 is not None:
        _check_hash(folder / "design.safetensors", manifest.design_sha256)
    return patterns


def recount(mirrors: np.ndarray, grid: Grid) -> np.ndarray:
    """Mirrors ON in each cell, shape (N,), of a frame's mirrors, bool (rows, columns)."""
    window = mirrors[_window(grid)].view(np.uint8)
    cells = window.reshape(grid.down, grid.height, grid.across, grid.width)
    return cells.sum(axis=(1, 3), dtype=np.uint32).ravel()


@dataclass(frozen=True)
class Cost:
    """Shares of a pass in which nothing is counted.

    Attributes
    ----------
    sentinels : float
        Frames for alignment, flux and dark.
    settling : float
        Starts of the masks' frames, while mirrors move.
    idle : float
        What the gates leave of the masks' frames: pictures that are longer than their share because
        no device shows shorter ones, and what is left where one more gate does not fit.
    """

    sentinels: float
    settling: float
    idle: float

    @property
    def total(self) -> float:
        """Share of the clock in which no gate is open."""
        return self.sentinels + self.settling + self.idle


def find_cost(
    manifest: Manifest,
    exposure_s: float,
    settle_s: float | None = None,
    repeats: int | None = None,
) -> Cost:
    """What the device costs in time at an exposure; parameters and errors as `find_gates`."""
    gates = find_gates(manifest, exposure_s, settle_s, repeats)
    masks = float(manifest.picture_s[manifest.shown].sum())
    settling = gates.settle_s * len(manifest.shown)
    idle = masks - settling - gates.repeats * float(gates.length_s.sum())
    whole = manifest.pass_s
    return Cost((whole - masks) / whole, settling / whole, max(idle, 0.0) / whole)


def describe(frame: Frame) -> str:
    """A frame in words."""
    if frame.role != "mask":
        return f"all {frame.role.upper()}"
    return f"mask {frame.mask}" + ("" if frame.rail == "both" else f", {frame.rail}")


@lru_cache(maxsize=4)
def order_mirrors(height: int, width: int) -> np.ndarray:
    """Place of each mirror of a cell in the order in which grey levels switch them ON.

    Each next mirror is the one that brings the mean of a repelling potential over the mirrors
    chosen closest to its mean over the whole cell (kernel herding), so that every beginning of the
    order represents the cell. Of very large cells whole blocks of mirrors are chosen, as often as
    they have mirrors, and each gives those in an order of its own.

    Returns
    -------
    array, shape (height, width)
        0 to height · width - 1, each once; read only.

    References
    ----------
    Y. Chen, M. Welling and A. Smola, "Super-samples from kernel herding", UAI, 2010.
    """
    rows, columns = height, width
    while rows * columns > HERD:
        rows, columns = (-(-rows // 2), columns) if rows > columns else (rows, -(-columns // 2))
    down, across = np.arange(height) * rows // height, np.arange(width) * columns // width
    block = np.add.outer(down * columns, across).ravel()
    chosen = _herd(np.bincount(down), np.bincount(across))
    order = np.empty(height * width, dtype=np.uint32)
    order[np.lexsort((_inside(down, across), block))] = np.argsort(chosen, kind="stable")
    order.flags.writeable = False
    return order.reshape(height, width)


def _inside(down: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Order of each mirror among those of its block; neighbouring blocks' are mirror images."""
    places = []
    for axis in (down, across):
        most = np.bincount(axis).max()
        place = np.arange(len(axis)) - np.searchsorted(axis, axis)
        places.append(np.where(axis % 2, most - 1 - place, place))
    most = tuple(int(place.max()) + 1 for place in places)
    if most == (1, 1):
        return np.zeros(len(down) * len(across), dtype=np.uint32)
    return order_mirrors(*most)[np.ix_(*places)].ravel()


def _herd(heights: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Blocks of a cell in the order of herding, each as often as it has mirrors.

    In whole numbers, so that every machine finds the same. They are exact although sums may pass 64
    bits on the way: what is compared is small, and what wraps around comes back.
    """
    near = []
    for sides in (heights, widths):
        centre = (np.cumsum(sides) - sides / 2) / sides.sum()
        distance = np.abs(np.subtract.outer(centre, centre))
        near.append(np.rint(UNIT * np.exp(-distance / SPREAD)).astype(np.int64))
    down, across = near
    free = np.outer(heights, widths)
    mirrors = int(free.sum())
    wanted = 2 * np.outer(down @ heights, across @ widths)
    excess = np.full(free.shape, UNIT**2 * mirrors)
    chosen = np.empty(mirrors, dtype=np.intp)
    for place in range(mirrors):
        excess -= wanted
        chosen[place] = excess.argmin()
        row, column = divmod(int(chosen[place]), len(widths))
        excess += np.outer(down[row], 2 * mirrors * across[column])
        free[row, column] -= 1
        if not free[row, column]:
            excess[row, column] = 2**62  # beyond what any other reaches
    return chosen


def _aligned(device: Device, grid: Grid) -> bool:
    """Whether every cell begins and ends with a byte, and a table of its grey levels is small."""
    return (
        grid.width % 8 == 0
        and grid.left % 8 == 0
        and (grid.mirrors + 1) * grid.mirrors <= 8 * MOST_TILE_BYTES
    )


def _look_up(on: Iterable[np.ndarray], device: Device, grid: Grid) -> Iterator[np.ndarray]:
    """Frames put together from packed cells, one for each grey level."""
    order = order_mirrors(grid.height, grid.width)
    levels = np.arange(grid.mirrors + 1)[:, None, None]
    tiles = np.concatenate(
        [np.packbits(order < some, axis=2) for some in np.array_split(levels, 64)]
    ).transpose(1, 0, 2)
    whole = np.ascontiguousarray(tiles).view(f"V{grid.width // 8}")[..., 0]
    for counts in on:
        frame = np.zeros((device.rows, -(-device.columns // 8)), dtype=np.uint8)
        rows = frame[grid.top : grid.top + grid.down * grid.height]
        left = grid.left // 8
        window = rows[:, left : left + grid.across * grid.width // 8]
        cells = whole[:, counts.reshape(grid.down, grid.across)]
        shape = grid.down, grid.height, grid.across * grid.width // 8
        window.reshape(shape)[...] = cells.transpose(1, 0, 2).copy().view(np.uint8).reshape(shape)
        yield frame


def _compare(on: Iterable[np.ndarray], device: Device, grid: Grid) -> Iterator[np.ndarray]:
    """Frames from comparing each mirror's place in the order with its cell's count."""
    order = order_mirrors(grid.height, grid.width)[None, :, None, :]
    for counts in on:
        lit = order < counts.reshape(grid.down, 1, grid.across, 1)
        yield _pack(lit, device, grid)


def _draw(
    on: Iterable[np.ndarray], device: Device, grid: Grid, rng: np.random.Generator
) -> Iterator[np.ndarray]:
    """Frames with mirrors drawn at random, as many as counted."""
    places = np.arange(grid.mirrors, dtype=np.uint32)
    for counts in on:
        lit = places < counts[:, None]
        grey = (counts > 0) & (counts < grid.mirrors)
        lit[grey] = rng.permuted(lit[grey], axis=1)
        cells = lit.reshape(grid.down, grid.across, grid.height, grid.width)
        yield _pack(cells.transpose(0, 2, 1, 3), device, grid)


def _pack(lit: np.ndarray, device: Device, grid: Grid) -> np.ndarray:
    """Packed frame of mirrors (down, height, across, width)."""
    mirrors = np.zeros((device.rows, device.columns), dtype=np.bool_)
    mirrors[_window(grid)] = lit.reshape(grid.down * grid.height, grid.across * grid.width)
    return np.packbits(mirrors, axis=1)


def _window(grid: Grid) -> tuple[slice, slice]:
    return (
        slice(grid.top, grid.top + grid.down * grid.height),
        slice(grid.left, grid.left + grid.across * grid.width),
    )


def _sequence(
    on: np.ndarray, device: Device, grid: Grid, selection: Selection, seed: int
) -> Iterator[np.ndarray]:
    """All frames: sentinels, masks, sentinels."""
    bright, dark = (np.packbits(_sentinel(device, grid, lit), axis=1) for lit in (True, False))
    yield from (bright, dark)
    yield from make_frames(on, device, grid, selection, seed)
    yield from (bright, dark)


def _sentinel(device: Device, grid: Grid, lit: bool) -> np.ndarray:
    """Mirrors of a frame in which every mirror of every cell is ON, or none is."""
    mirrors = np.zeros((device.rows, device.columns), dtype=np.bool_)
    mirrors[_window(grid)] = lit
    return mirrors


def _write_frames(
    folder: Path,
    format: Format,
    device: Device,
    total: int,
    frames: Iterable[np.ndarray],
    progress: Callable[[float], None] | None,
) -> list[str]:
    """Write frames as they come; their hashes."""
    hashes = []
    shape = (total, device.rows, -(-device.columns // 8))
    if format == "png":
        (folder / "frames").mkdir()
    stream = None if format == "png" else (folder / STREAMS[format]).open("wb")
    with stream or nullcontext():
        if format == "npy" and stream:
            _write_header(stream, np.dtype("u1"), shape)
        for place, frame in enumerate(frames):
            hashes.append(hashlib.sha256(frame.data).hexdigest())
            if stream:
                stream.write(frame.data)
            else:
                picture = Image.frombytes("1", (device.columns, device.rows), frame.tobytes())
                picture.save(folder / _png(place, total), compress_level=1)  # faster, no larger
            if progress is not None:
                progress((place + 1) / total)
    return hashes


def _frames(folder: Path, manifest: Manifest) -> Iterator[np.ndarray]:
    device, total = manifest.device, len(manifest.frames)
    shape = (device.rows, -(-device.columns // 8))
    if manifest.format == "png":
        for place in range(total):
            yield _read_png(folder / _png(place, total), device).reshape(shape)
        return
    header = "|u1" if manifest.format == "npy" else None
    with _array(folder / STREAMS[manifest.format], header, (total, *shape)) as file:
        for _ in range(total):
            yield np.frombuffer(file.read(device.frame_bytes), dtype=np.uint8).reshape(shape)


def _read_png(path: Path, device: Device) -> np.ndarray:
    try:
        with PngImagePlugin.PngImageFile(path) as picture:
            if picture.mode != "1" or picture.size != (device.columns, device.rows):
                raise InputError(
                    f"{path} is a {picture.size[0]} x {picture.size[1]} PNG of mode "
                    f"{picture.mode}, not {device.columns} x {device.rows} at one bit a pixel: "
                    "export the patterns again"
                )
            return np.frombuffer(picture.tobytes(), dtype=np.uint8)
    except FileNotFoundError:
        raise InputError(f"frame {path} is missing: export the patterns again") from None
    except InputError:
        raise
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(
            f"frame {path} cannot be read ({error}): export the patterns again"
        ) from None


def _write_header(file: IO[bytes], dtype: np.dtype[Any], shape: tuple[int, ...]) -> None:
    """Header of an array's .npy file, as `numpy.save` writes it."""
    content = {"descr": dtype.str, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, content)


@contextmanager
def _array(
    path: Path, kind: str | None, shape: tuple[int, ...], first: int = 0
) -> Iterator[IO[bytes]]:
    """Open a file at the start of an array's data, certain that all of it is there.

    With a `kind` the file has a header of numpy's, which must say that type and `shape`. The
    array's first row is of frame `first`.
    """
    again = "export the patterns again"
    try:
        with path.open("rb") as file:
            dtype = np.dtype(kind or "u1")
            if kind is not None:
                header = io.BytesIO()
                _write_header(header, dtype, shape)
                if file.read(len(header.getvalue())) != header.getvalue():
                    raise InputError(
                        f"{path} is not a numpy file of {dtype} numbers of shape {shape}, as "
                        f"manifest.json says: {again}"
                    )
            size = dtype.itemsize
            wanted = size * math.prod(shape)
            here = path.stat().st_size - file.tell()
            if here != wanted:
                per = size * math.prod(shape[1:])
                raise InputError(
                    f"{path} has {here} bytes of data, and manifest.json says {wanted}: it breaks "
                    f"off in frame {first + here // per}; {again}"
                    if here < wanted
                    else f"{path} has {here - wanted} bytes too many: {again}"
                )
            yield file
    except FileNotFoundError:
        raise InputError(f"{path} is missing: {again}") from None
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read ({error}): {again}") from None


def _check_hash(path: Path, sha256: str) -> None:
    try:
        with path.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(
            f"{path} cannot be read ({error.strerror}): export the patterns again"
        ) from None
    if found != sha256:
        raise InputError(f"{path} is not the design that was exported: export the patterns again")


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


def _png(place: int, total: int) -> str:
    return f"frames/{place:0{max(4, len(str(total - 1)))}d}.png"
