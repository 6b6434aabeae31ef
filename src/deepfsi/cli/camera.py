"""Commands of the camera: virtual and real acquisitions, photon files, calibration."""

import contextlib
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.base import (
    InputError,
    as_input_error,
    closest_choice,
    count_text,
    read_toml,
    time_text,
    write_atomically,
)
from deepfsi.cli import common, options, paths
from deepfsi.cli.groups import Group
from deepfsi.cli.settings import COUNTER_EFFECTS, laboratory_fields, with_settings

if TYPE_CHECKING:
    import numpy as np

    from deepfsi.camera import Camera
    from deepfsi.hardware.counting import Counts
    from deepfsi.hardware.live import LiveCounts
    from deepfsi.hardware.photons import PtuSummary
    from deepfsi.hardware.virtual import VirtualCamera

NO_DRIFT = 1e-7
"""Drift of clocks that is printed as none, as a share."""

SMALL_DRIFT = 1e-3
"""Drift of clocks that is printed in ppm, as a share."""

camera = typer.Typer(
    cls=Group,
    invoke_without_command=True,
    callback=common.help_if_bare,
    help="Runs of a camera, virtual or real: from photon files to counts, classes and pictures.\n\n"
    "Example: deepfsi camera count run_0001",
)

MOST_EVENTS = 1e8
"""Photons of a simulated recording that are written without asking."""

EVENT_BYTES = 4
"""Bytes of a photon in its file."""


CAMERA_EXAMPLES = {
    "rails": '"single"',
    "detectors": '"1x1"',
    "readout": '"difference"',
    "device": '"dlp7000"',
    "exposure": '"10ms"',
    "region": '"768x768"',
    "stretch": "false",
    "shortest_dwell": '"32us"',
    "levels": "2",
    "flux": "1e6",
    "dark": "200",
    "dead_time": '"20ns"',
    "dead_time_model": '"non-paralysable"',
    "noise": '"camera"',
    "gates": "1",
    "sigma": "0.0",
    "fluctuation": "0.05",
}
"""Values of a camera file, as TOML writes them."""


def camera_template() -> str:
    """A camera file with a comment on each field, as a laboratory may fill it in."""
    from deepfsi.camera import Camera

    lines = ["# A camera: leave out what you do not know, or what follows from the rest.", ""]
    usual = {"light": '"free-dwell"'}
    for name, field in Camera.model_fields.items():
        lines.append(f"# {field.description}")
        lines.append(
            f"{name} = {usual[name]}" if name in usual else f"# {name} = {CAMERA_EXAMPLES[name]}"
        )
        lines.append("")
    return "\n".join(lines)


@with_settings(laboratory_fields, leave=("camera",))
def camera_describe(
    settings: dict[str, Any],
    source: Annotated[
        Path | None,
        typer.Argument(
            help="camera: a preset (dmd, dmd-2x2, dmd-4x4, two-arm, paper), a TOML file, a design "
            "file, or a folder of patterns or of a run; dmd unless given"
        ),
    ] = None,
    template: Annotated[
        Path | None, typer.Option(help="write a camera file, .toml, with a comment on each field")
    ] = None,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Say in words what a camera is, what it can show and what light it has.

    Example: deepfsi camera describe --template my-lab.toml
    """
    from deepfsi.camera import PRESETS, Camera

    if template is not None:
        paths.check_file(template, (".toml",), force)
        write_atomically(template, camera_template().encode())
        print(f"camera file: {template}; then: deepfsi camera describe {template}")
        return
    name = "dmd" if source is None else str(source)
    if name in PRESETS or name.lower().endswith(".toml") or not Path(name).exists():
        found = Camera.load(name, **settings)
    else:
        found = camera_of(Path(name), settings)
    if as_json:
        held = found.model_dump(mode="json")
        counted = {"budget": found.budget, "dark_counts": found.dark_counts}
        shown = {"shortest_share": found.shortest_share}
        common.print_json("camera.describe", {"camera": held, **counted, **shown})
        return
    print(found.describe())


@with_settings(laboratory_fields, "exposure", "flux", "dark", *COUNTER_EFFECTS)
def camera_simulate(
    patterns: Annotated[Path, typer.Argument(help="folder of patterns")],
    settings: dict[str, Any],
    scene: options.Scenes,
    out: Annotated[Path, typer.Option("--out", "-o", help="acquisition folder, new")],
    virtual: options.Virtual = None,
    settle: options.Settle = None,
    repeats: options.Repeats = None,
    inputs: options.Inputs = None,
    seed: options.CameraSeed = 0,
    yes: options.LargeFile = False,
    as_json: options.Json = False,
) -> None:
    """Record scenes with a virtual camera, in a photon file such as a real counter writes.

    Exposure, flux, dark counts, dead time and gates are those of the design's camera unless given.

    Example: deepfsi camera simulate patterns --scene images --flux 1e7 --exposure 10ms -o run_0001
    """
    paths.check_new_folder(out)
    from deepfsi.hardware.patterns import read_patterns
    from deepfsi.hardware.virtual import RecordingSettings, expected_events, record_scenes
    from deepfsi.lab import displayed, picture_hashes

    known = camera_of(patterns, settings)
    seen = find_camera(virtual, patterns, settings)
    if virtual is None:
        seen = seen.model_copy(update={"gates": camera_of(patterns).clicks})
    recording = RecordingSettings(
        seen,
        flux_of(known),
        exposure_of(known),
        options.optional_seconds("settle", settle),
        repeats,
        seed,
        **options.wiring(inputs, None),
    )
    shown = read_patterns(patterns)
    images = displayed(scene, patterns)
    if not yes:
        ask_for_room(expected_events(shown, images.x, recording.camera, recording.flux))
    with common.progress("photons", quiet=as_json) as report:
        hashes = picture_hashes(scene, patterns)
        told = images.x, images.names, images.labels
        made = record_scenes(patterns, *told, out, recording, report, hashes)
    if as_json:
        common.print_json(
            "camera.simulate",
            {
                "folder": str(out),
                "preprocessing": images.preprocessing,
                "acquisition": made.model_dump(mode="json"),
            },
        )
        return
    print(
        f"scenes: {scene}. {images.preprocessing}\n"
        f"{common.several(len(made.scenes), 'scene')}, {common.several(made.repeats, 'exposure')} "
        f"of {time_text(made.exposure_s)} for each\n"
        f"recorded: {out}"
    )


@with_settings(laboratory_fields, *COUNTER_EFFECTS)
def camera_count(
    folder: options.Run,
    settings: dict[str, Any],
    exposure: options.Exposure = None,
    settle: options.Settle = None,
    repeats: options.Repeats = None,
    tolerance: Annotated[
        str | None,
        typer.Option(help="how far a marker may be off; 10us or a tenth of a frame unless given"),
    ] = None,
    background: Annotated[
        str | None,
        typer.Option(
            help="scene of this run that was dark, or folder of a run with the scene dark: its "
            "counts are subtracted"
        ),
    ] = None,
    inputs: options.Inputs = None,
    marker: options.Marker = None,
    flat: Annotated[
        Path | None,
        typer.Option(
            help="several detectors: counted run of a uniform white scene with the same patterns, "
            "by which their efficiencies are corrected"
        ),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Count the photons in each frame's gate; name missing, doubled and late markers.

    An exposure shorter than the recorded one is counted in more and shorter gates. If all frames
    last longer or shorter than planned, they are counted as they are, and the drift is printed.

    Unless given, inputs and marker are those of the acquisition, and the dead time is that of the
    folder's calibration or of the design's camera.

    For a design of detectors that click, the exposure of a frame is divided into equal gates, and
    only the first photon of each gate counts.

    Example: deepfsi camera count run_0001 --exposure 1ms
    """
    from deepfsi.hardware.counting import CountSettings, count_run
    from deepfsi.hardware.live import LiveCounts, is_live
    from deepfsi.lab import gains_of

    if folder.suffix.lower() == ".ptu":
        raise InputError(
            f"{folder} is a photon file without patterns: give the folder of an acquisition, or "
            "use `deepfsi camera transits` for scenes that pass a pattern"
        )
    given = (exposure, settle, repeats, tolerance, background, inputs, marker, flat)
    if is_live(folder, *given, *settings.values()):
        with common.progress("counting", quiet=as_json) as report:
            _print_live_counts(LiveCounts.count(folder, report), folder, as_json)
        return
    with common.progress("counting", quiet=as_json) as report:
        counts = count_run(
            folder,
            CountSettings(
                exposure_s=options.optional_seconds("exposure", exposure),
                settle_s=options.optional_seconds("settle", settle),
                repeats=repeats,
                tolerance_s=options.optional_seconds("tolerance", tolerance),
                **options.wiring(inputs, marker),
                effects=camera_of(folder, settings).counter_effects(settings),
                background=background,
                gains=() if flat is None else gains_of(flat),
                clicks=camera_of(folder).clicks,
            ),
            progress=report,
        )
    print_counts(counts, folder, as_json)


def print_counts(
    counts: "Counts", folder: Path, as_json: bool, command: str = "camera.count"
) -> None:
    """Print what was counted, and every fault."""
    from deepfsi.hardware.counting import read_run
    from deepfsi.hardware.photons import PtuFile

    run = read_run(folder).acquisition
    names = [scene.name for scene in run.scenes]
    problems = PtuFile(folder / "photons.ptu").problems
    summary: dict[str, Any] = {
        "scenes": len(counts.counts),
        "exposures": int(counts.valid.size),
        "whole": int(counts.valid.sum()),
        "exposure_s": counts.exposure_s,
        "photons_counted": int(counts.counts.sum()),
        "photons": [None if math.isnan(each) else each for each in counts.photons.tolist()],
        "dark_rate": counts.dark_rate.tolist(),
        "drift": counts.drift,
        "inputs": [each + 1 for each in counts.inputs],
        "dead_time_s": counts.effects.dead_time.seconds,
        "paralysable": counts.effects.dead_time.paralysable,
        "arrivals": float(counts.arrivals.sum()),
        "ambient": float(counts.ambient.sum()),
        "gains": list(counts.gains),
        "gates": counts.gates,
        "problems": list(problems),
    }
    if as_json:
        faults = [
            fault.model_dump() | {"name": None if fault.scene is None else names[fault.scene]}
            for fault in counts.faults
        ]
        measured = {"counts": counts.counts.tolist(), "valid": counts.valid.tolist()}
        common.print_json(command, {**summary, "faults": faults, **measured})
        return
    for problem in problems:
        print(f"photons.ptu: {problem}")
    for fault in counts.faults:
        print(fault.line(names))
    if counts.effects.dead_time.seconds:
        lost = 1 - summary["photons_counted"] / max(summary["arrivals"], 1.0)
        print(
            f"dead time of {counts.effects.dead_time}: {lost:.1%} of the photons were lost, and "
            "are added"
        )
    if counts.gains:
        print(f"efficiencies corrected: {', '.join(f'{gain:.3f}' for gain in counts.gains)}")
    kind = "photons" if counts.gates is None else f"clicks of up to {counts.gates} a frame"
    stated = counts.gates is not None and run.flux in counts.flux
    source = "that acquisition.json states" if stated else "by the all-ON frames"
    print(
        f"{summary['scenes']} scenes, {summary['exposures']} exposures of "
        f"{time_text(counts.exposure_s)}, {summary['whole']} of them whole\n"
        f"{summary['photons_counted']} {kind} counted\n"
        f"budget {source}: {_span(counts.photons)} photons an exposure\n"
        f"dark counts: {_span(counts.dark_rate[counts.valid.any(axis=1)])} a second\n"
        f"clocks: frames last {_drifted(counts.drift)}\n"
        f"{_ambient(counts)}"
        f"counts: {folder / 'counts.npz'}"
    )


def _print_live_counts(counts: "LiveCounts", folder: Path, as_json: bool) -> None:
    looks = [shown.look for scene in counts.log.scenes for shown in scene.lists]
    summary = {
        "scenes": len(counts.log.scenes),
        "looks": sum(look >= 0 for look in looks),
        "frames": len(counts.frames.starts_s),
        "photons_counted": int(counts.frames.parts.sum()),
    }
    if as_json:
        rows = [
            [{"look": shown.look, "frames": shown.frames, "counts": counted.counts.tolist()}
             for shown, counted in zip(scene.lists, lists, strict=True)]
            for scene, lists in counts.by_scene
        ]  # fmt: skip
        common.print_json("camera.count", {**summary, "counts": rows})
        return
    print(
        f"a live run: {summary['scenes']} scenes, {summary['looks']} looks, {summary['frames']} "
        f"frames\n{summary['photons_counted']} photons counted\n"
        f"counts: {folder / 'counts.npz'}"
    )


def _ambient(counts: "Counts") -> str:
    """Line on the background that was measured; nothing where none was."""
    if not counts.ambient_variance.any():
        return ""
    error = math.sqrt(counts.ambient_variance.sum())
    return f"background subtracted: {counts.ambient.sum():.4g} ± {error:.2g} counts an exposure\n"


def _drifted(drift: float) -> str:
    if abs(drift) < NO_DRIFT:
        return "as planned"
    size = f"{abs(drift) * 1e6:.1f} ppm" if abs(drift) < SMALL_DRIFT else f"{abs(drift):.2%}"
    return f"{size} {'shorter' if drift < 0 else 'longer'} than planned"


def camera_image(
    folder: options.Run,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="picture; picture.png in the folder unless given"),
    ] = None,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Draw the least-squares reconstruction of each scene from its counts, to align the camera.

    Example: deepfsi camera image run_0001 -o picture.png
    """
    target = out or folder / "picture.png"
    if out is not None:
        paths.check_file(out, paths.PICTURES, force)
    paths.check_there(folder, "an acquisition folder, with photons.ptu in it")
    from deepfsi.hardware.counting import read_run
    from deepfsi.hardware.pictures import reconstruct
    from deepfsi.report import pictures_figure

    acquisition = read_run(folder).acquisition
    figure = pictures_figure(reconstruct(folder), [scene.name for scene in acquisition.scenes])
    common.draw("camera.image", figure, target, as_json)


def camera_inspect(
    file: Annotated[Path, typer.Argument(help="PicoQuant .ptu file")], as_json: options.Json = False
) -> None:
    """List what a photon file holds: records, photons and markers by channel, overflows, duration.

    A file that is cut or damaged is described as far as it goes, and the exit code is 2.

    Example: deepfsi camera inspect photons.ptu
    """
    from deepfsi.hardware.photons import summarise

    with common.progress("records", quiet=as_json) as report:
        contents = summarise(file, report)
    if as_json:
        common.print_json(
            "camera.inspect",
            contents.model_dump()
            | {"photons": {each + 1: n for each, n in contents.photons.items()}}
            | {"markers": {bit.bit_length() - 1: n for bit, n in contents.markers.items()}},
        )
    else:
        _print_contents(file, contents)
    if contents.problems:
        raise InputError(f"{file} is not whole: {'; '.join(contents.problems)}")


def _print_contents(file: Path, contents: "PtuSummary") -> None:
    rows = [
        ("record type", contents.kind),
        ("time unit", time_text(contents.tick_s)),
        ("records", str(contents.records)),
        *((f"photons on input {k + 1}", str(n)) for k, n in contents.photons.items()),
        *((f"markers on {k.bit_length() - 1}", str(n)) for k, n in contents.markers.items()),
        ("overflow records", str(contents.overflows)),
        ("sync records", str(contents.syncs)),
        ("span", time_text(contents.span_s)),
        *(("problem", problem) for problem in contents.problems),
    ]
    common.print_table(str(file), ("what", "value"), rows)


def ask_for_room(events: float) -> None:
    """Ask before a photon file beyond `MOST_EVENTS`; `InputError` where there is no one to ask."""
    if events <= MOST_EVENTS:
        return
    size = f"{events:.2g} photons, {events * EVENT_BYTES / 1e9:.2g} GB"
    if sys.stdin.isatty() and typer.confirm(f"The recording will hold {size}. Go on?", err=True):
        return
    raise InputError(
        f"the recording would hold {size}: lower --flux, show fewer scenes, export with a shorter "
        "--exposure (all of a pass is recorded), or add --yes"
    )


def camera_of(source: Path, settings: Mapping[str, Any] = MappingProxyType({})) -> "Camera":
    """Camera of a design file, its patterns or a run, with other settings.

    It is the preset `dmd` where none is known. `camera` among the settings names another.
    """
    from deepfsi.camera import Camera
    from deepfsi.designfile import DesignFile
    from deepfsi.hardware.patterns import Patterns

    folders = (source, source / "patterns") if source.is_dir() else ()
    files = (folder / Patterns.DESIGN for folder in folders)
    file = next((file for file in files if file.is_file()), source)
    known = None
    if file.is_file():
        with contextlib.suppress(InputError):  # whoever opens the design says what is wrong with it
            known = DesignFile.read(file, ()).camera
    return Camera.of_run(known, **settings)


def exposure_of(known: "Camera") -> float:
    """Time of a whole exposure in seconds, or `InputError` where the camera has none."""
    if known.exposure is None:
        raise InputError(
            "an exposure needs a time: give {exposure}, such as 10ms, or a camera",
            setting="exposure",
        )
    return known.exposure


def flux_of(known: "Camera") -> float:
    """Flux in counts/s, or `InputError` where the camera has none."""
    if known.flux is None:
        raise InputError(
            "a virtual camera needs its light: give {flux}, such as 1e6, or a camera",
            setting="flux",
        )
    return known.flux


def find_camera(name: str | None, source: Path, settings: dict[str, Any]) -> "VirtualCamera":
    """Virtual camera of a name or a TOML file, else as the design's camera is described.

    Where that has neither an exposure time, gates nor a fluctuation it is no laboratory's, and a
    photomultiplier is taken.
    """
    from deepfsi.hardware.virtual import CAMERAS, VirtualCamera

    if name is None:
        known = camera_of(source, {"camera": settings.get("camera")})
        laboratory = known.exposure is not None or known.clicks is not None
        described = laboratory or known.fluctuation > 0
        return VirtualCamera.of(camera_of(source, settings)) if described else CAMERAS["pmt"]
    if name in CAMERAS:
        return CAMERAS[name]
    if not name.lower().endswith(".toml"):
        raise InputError(
            f"unknown camera {name!r}: {closest_choice(name, CAMERAS)}; or give a TOML file"
        )
    with as_input_error():
        return VirtualCamera.model_validate(read_toml(name))


def _span(values: "np.ndarray") -> str:
    """The numbers among some, from the least to the largest."""
    import numpy as np

    if np.isnan(values).all():
        return "unknown"
    ends = [count_text(end) for end in (np.nanmin(values), np.nanmax(values))]
    return " to ".join(dict.fromkeys(ends))
