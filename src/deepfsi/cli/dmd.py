"""Commands of the micromirror device: patterns written and checked."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.base import InputError, time_text
from deepfsi.cli import common, options, paths
from deepfsi.cli.camera import camera_of
from deepfsi.cli.groups import Group
from deepfsi.cli.settings import SettingsCommand, laboratory_fields, with_settings

if TYPE_CHECKING:
    from deepfsi.camera import Camera, Device, DmdGrid, DmdLayout
    from deepfsi.hardware.patterns import DesignRails, GatePlan, Manifest, Patterns

SLACK = 1.01
"""Time of pictures over what the gates of an exposure take: pictures are of whole microseconds."""

SENTINEL_SHARE = 0.1
"""Time of an all-ON frame of several looks, as a share of the exposure: it measures their light."""

dmd = typer.Typer(
    cls=Group,
    invoke_without_command=True,
    callback=common.help_if_bare,
    help="Patterns for a micromirror device (DMD): export and check them, list the devices.\n\n"
    "Example: deepfsi dmd export digits.safetensors --device dlp7000 --exposure 10ms -o patterns",
)


@dmd.command("export", cls=SettingsCommand)
@with_settings(laboratory_fields, "device", "exposure", "region", "stretch")
def dmd_export(
    file: Annotated[
        Path, typer.Argument(help="design file; or raster or hadamard, to calibrate with")
    ],
    settings: dict[str, Any],
    out: Annotated[Path, typer.Option("--out", "-o", help="folder for the patterns, new")],
    size: Annotated[
        str | None,
        typer.Option(help="cells of raster or hadamard, HEIGHTxWIDTH; 32x32 unless given"),
    ] = None,
    detectors: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=64,
            help="number of detectors during raster or hadamard, so that `camera calibrate` finds "
            "the cells of each; 1 unless given",
        ),
    ] = None,
    shortest: Annotated[
        str | None, typer.Option(help="shortest picture time of the device; its own unless given")
    ] = None,
    settle: Annotated[
        str | None, typer.Option(help="time for its mirrors to settle; its own unless given")
    ] = None,
    dwell: Annotated[
        str | None,
        typer.Option(
            hidden=True,
            help="mean picture time of a frame, settling included, such as 1ms or 44us; what the "
            "camera's exposure takes unless given, or 1ms",
        ),
    ] = None,
    selection: Annotated[
        str, typer.Option(help="mirrors of a grey cell: ordered (low discrepancy) or random")
    ] = "ordered",
    seed: Annotated[int, typer.Option(min=0, help="seed of a random selection")] = 0,
    flip: Annotated[
        bool, typer.Option("--flip", help="exchange left and right of the masks, before --rotate")
    ] = False,
    rotate: Annotated[
        int, typer.Option(help="turn the masks on the device, degrees clockwise: 0, 90, 180, 270")
    ] = 0,
    invert: Annotated[
        bool,
        typer.Option(
            "--invert", help="write 0 for a mirror that sends light to the detector, and 1 for OFF"
        ),
    ] = False,
    kind: Annotated[
        str | None,
        typer.Option(
            "--format",
            help="npy or raw (packed bits), png or bmp (one a frame), or planes (24 frames a "
            "picture); what the device takes unless given",
        ),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Write the frames of a design for a micromirror device, with a manifest.

    Device, region and exposure are those of the design's camera unless given; a DLP7000 where it
    has none. Cells are square. Where `camera check` finds that your camera shows scenes turned or
    flipped, export again with the --flip and --rotate that it names.

    A calibration needs no design: deepfsi dmd export hadamard --size 32x32 -o scan

    Example: deepfsi dmd export one-dmd.safetensors --device dlp7000 --exposure 10ms -o patterns
    """
    paths.check_new_folder(out)
    from deepfsi.camera import find_device
    from deepfsi.hardware.calibration import SCAN_NAMES, write_reference
    from deepfsi.hardware.patterns import FrameSettings, export_patterns

    file = file if str(file) in SCAN_NAMES else paths.check_design(file)
    rails = _rails(file, size, detectors)
    known = camera_of(file, settings)
    shown_by = (known.device or find_device("dlp7000")).timed(
        options.optional_seconds("shortest", shortest), options.optional_seconds("settle", settle)
    )
    asked = options.optional_seconds("dwell", dwell)
    frames = FrameSettings(
        shown_by,
        _picture_time(rails, shown_by, known) if asked is None else asked,
        selection,  # type: ignore[arg-type]
        seed,
        kind or ("planes" if shown_by.packed else "npy"),  # type: ignore[arg-type]
        _layout(known.layout, flip=flip, rotate=rotate, invert=invert),
    )
    with common.progress("patterns", quiet=as_json) as report:
        patterns = export_patterns(rails, frames, out, report)
    write_reference(patterns, out)
    if frames.raised and not as_json:
        print(
            f"the mean picture time was raised to {frames.device.shortest_us} µs: "
            f"{frames.device.name} shows no shorter picture (--shortest)"
        )
    _print_patterns("dmd.export", patterns, out, as_json)


def _picture_time(rails: "DesignRails", device: "Device", camera: "Camera") -> float:
    """Mean picture time of a frame in seconds: what the camera's exposure takes, or 1 ms."""
    if camera.exposure is None:
        return 1e-3
    if rails.looks is not None:  # a live run times the masks itself
        return max(SENTINEL_SHARE * camera.exposure, device.shortest_us * 1e-6)
    frames = int((rails.rails.max(axis=-1) > 0).sum())
    return SLACK * camera.exposure / frames + device.settle_us * 1e-6


def _layout(known: "DmdLayout", **options: Any) -> "DmdLayout":
    """Layout of a camera, with the orientation of options."""
    from deepfsi.base import as_input_error
    from deepfsi.camera import DmdLayout

    with as_input_error():
        return DmdLayout.model_validate(known.model_dump() | options)


def _rails(file: Path, size: str | None, detectors: int | None) -> "DesignRails":
    """Rails of a design file, or of a scan by its name."""
    from deepfsi.hardware.calibration import SCAN_NAMES, scan_rails

    if str(file) in SCAN_NAMES:
        return scan_rails(str(file), options.size_of(size) or (32, 32), detectors or 1)
    for option, given, own in (("size", size, "cells"), ("detectors", detectors, "detectors")):
        if given is not None:
            raise InputError(
                f"--{option} is for {' and '.join(SCAN_NAMES)}: {file} has the {own} of its "
                "design; leave it out"
            )
    from deepfsi.lab import design_rails

    return design_rails(file)


@dmd.command("check")
def dmd_check(
    folder: Annotated[Path, typer.Argument(help="folder of patterns")],
    as_json: options.Json = False,
) -> None:
    """Read every frame of a folder back and compare it with the manifest.

    Example: deepfsi dmd check patterns
    """
    from deepfsi.hardware.patterns import check_patterns

    with common.progress("frames", quiet=as_json) as report:
        patterns = check_patterns(folder, report)
    _print_patterns("dmd.check", patterns, folder, as_json)


@dmd.command("devices")
def dmd_devices(as_json: options.Json = False) -> None:
    """List the devices that have a name, with their limits and where each number is from.

    Example: deepfsi dmd devices
    """
    from deepfsi.camera import DEVICE_SOURCES, DEVICES

    every = list(DEVICES.values())
    if as_json:
        common.print_json(
            "dmd.devices",
            {
                "devices": [
                    {**one.model_dump(), "sources": DEVICE_SOURCES[one.name]} for one in every
                ]
            },
        )
        return
    rows = [
        [
            one.name,
            f"{one.columns} x {one.rows}",
            one.lattice,
            f"{one.pitch_um}",
            f"{one.shortest_us}",
            "memory" if one.patterns is None else f"{one.patterns}",
            "planes" if one.packed else "npy",
        ]
        for one in every
    ]
    heads = ["device", "mirrors", "lattice", "pitch, µm", "shortest, µs", "frames", "format"]
    common.print_table("Devices", heads, rows)
    print("where each number is from, and what is assumed: deepfsi dmd devices --json")


def _print_patterns(command: str, patterns: "Patterns", folder: Path, as_json: bool) -> None:
    from dataclasses import asdict

    from deepfsi.hardware.patterns import GatePlan

    manifest, device, grid = patterns.manifest, patterns.manifest.device, patterns.manifest.grid
    times = [frame.picture_us for frame in manifest.frames]
    longest = gates = None
    if manifest.looks is None:
        longest = manifest.longest_exposure_s(device.settle_us * 1e-6)
        gates = GatePlan.of(manifest, longest)
    if as_json:
        common.print_json(
            command,
            {
                "patterns": str(folder),
                "frames": len(manifest.frames),
                "mask_frames": len(manifest.shown),
                "mean_picture_s": float(manifest.picture_s[manifest.shown].mean()),
                "pass_s": manifest.pass_s,
                "longest_exposure_s": longest,
                "uncounted": None if gates is None else asdict(gates.cost(manifest)),
                "dimmed": manifest.dimmed,
                "looks": manifest.looks.count if manifest.looks else 1,
                "load_s": device.load_us and device.load_us * 1e-6,
                "device": device.name,
                "cell": [grid.height, grid.width],
                "aspect": grid.aspect,
                "used": manifest.used,
                "layout": manifest.layout.model_dump(),
                "most_frames": device.patterns,
                "picture_us": [min(times), max(times)],
                "departures": manifest.departures,
            },
        )
        return
    print(
        f"{_counted(manifest, longest, gates)}\n{_placed(manifest, grid)}\n"
        f"limits of {device.name}: {len(manifest.frames)} frames"
        f"{'' if device.patterns is None else f' of {device.patterns}'}, pictures of "
        f"{min(times)} to {max(times)} µs ({_allowed(device)} allowed)"
    )
    for departure in manifest.departures:
        print(f"beyond its documents: {departure}")
    if manifest.dimmed < 0.999:
        print(
            f"cost in light: one device shows a {manifest.light} design with "
            f"{manifest.dimmed:.3g} of its light; learn it with --light free-dwell or "
            "equal-dwell instead"
        )
    print(f"patterns: {folder}")


def _allowed(device: "Device") -> str:
    """Times of pictures that a device allows, µs."""
    from deepfsi.camera import LONGEST_PICTURE_S

    if device.longest_us == LONGEST_PICTURE_S * 1e6:
        return f"{device.shortest_us} or more"
    return f"{device.shortest_us} to {device.longest_us}"


def _placed(manifest: "Manifest", grid: "DmdGrid") -> str:
    """Cells on the device, in words."""
    device, layout = manifest.device, manifest.layout
    columns, rows = grid.across * grid.width, grid.down * grid.height
    shape = "square" if abs(grid.aspect - 1) < 1e-9 else f"{grid.aspect:.3g} times as wide as high"
    turned = [
        *(["flipped"] if layout.flip else []),
        *([f"turned by {layout.rotate} degrees clockwise"] if layout.rotate else []),
        *(["1 is OFF in the files"] if layout.invert else []),
    ]
    return (
        f"cells of {grid.width} x {grid.height} mirrors, {shape}, on {columns} x {rows} of "
        f"{device.columns} x {device.rows} mirrors: {manifest.used:.1%} of the device's light is "
        f"used{''.join(f'; {each}' for each in turned)}"
    )


def _counted(manifest: "Manifest", longest: float | None, gates: "GatePlan | None") -> str:
    """Frames of a pass, its longest exposure and what it costs, in words."""
    sentinels = len(manifest.frames) - len(manifest.shown)
    shown = common.several(len(manifest.shown), "frame")
    frames = f"{shown} of masks and {sentinels} all-ON and all-OFF ones"
    device, chosen = manifest.device, manifest.looks
    if chosen and chosen.adaptive:
        return (
            f"{frames}: the mask of the first look, of {chosen.count}; a live run loads a new one "
            f"before each look, {device.load_us} µs a frame on {device.name}, in which no photon "
            "is counted; show them with `deepfsi camera live`"
        )
    if chosen or gates is None or longest is None:
        looks = chosen.count if chosen else 1
        return (
            f"{frames}, {looks} looks: the times written are of the first, those of the others "
            "follow from counts; show them with `deepfsi camera live`"
        )
    reason = f"no picture is shorter than {manifest.device.shortest_us} µs"
    if manifest.device.video_us:
        reason = "all pictures last as long as the longest"
    cost = gates.cost(manifest)
    return (
        f"{frames}, {time_text(manifest.pass_s)} a pass, exposures up to {time_text(longest)}\n"
        f"cost in time: at that exposure {cost.total:.1%} of a pass is not counted: "
        f"{cost.sentinels:.1%} for all-ON and all-OFF frames, {cost.settling:.1%} for mirrors "
        f"to settle, {cost.idle:.1%} since {reason}"
    )
