"""Live runs: a projector and a counter that show, count and decide; and their replay."""

import contextlib
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.cli import camera, common, options, paths, replays
from deepfsi.errors import InputError, as_input_error, check_known

if TYPE_CHECKING:
    from deepfsi.datasets.display import Display
    from deepfsi.hardware.live.run import Bench, Decided
    from deepfsi.hardware.recording.acquisition import Acquisition
    from deepfsi.hardware.virtual.bench import Latencies

PROJECTORS, COUNTERS = ("virtual", "vialux"), ("virtual", "picoquant", "followed")
"""Devices by name; `followed` is a PicoQuant counter whose software writes the photon file."""
_OWN = {
    "counter_config": "--counter picoquant",
    "alp_version": "--projector vialux",
    **dict.fromkeys(("flux", "settings", "latency", "seed", "yes"), "virtual devices"),
}
"""Parameters that only some devices take."""


def camera_live(
    context: typer.Context,
    source: Annotated[
        Path, typer.Argument(help="folder of patterns; or a design file, shown on a DLP7000")
    ],
    scene: options.Scenes,
    exposure: Annotated[str, typer.Option(help="exposure of all looks, such as 0.01 or 10ms")],
    out: Annotated[Path, typer.Option("--out", "-o", help="acquisition folder, new")],
    projector: Annotated[str, typer.Option(help="virtual, or vialux")] = "virtual",
    counter: Annotated[
        str,
        typer.Option(help="virtual, picoquant, or followed: its software writes OUT/photons.ptu"),
    ] = "virtual",
    counter_config: Annotated[
        Path | None,
        typer.Option(help="picoquant: snAPI's .ini file with the trigger levels of the inputs"),
    ] = None,
    alp_version: Annotated[
        str | None, typer.Option(help="vialux: version of the ALP interface, 4.3 unless given")
    ] = None,
    flux: Annotated[
        float | None,
        typer.Option(help="photons/s on the device, for the mean training scene; virtual"),
    ] = None,
    settings: options.CameraSettings = "pmt",
    latency: Annotated[
        list[str] | None,
        typer.Option(
            help="NAME=TIME of a virtual device: load, display, command, trigger, block, transfer "
            "or decision, such as command=1ms"
        ),
    ] = None,
    until: Annotated[
        float | None,
        typer.Option(
            help="confidence above which an exposure stops; that of the design's rule unless given"
        ),
    ] = None,
    shortest_dwell: Annotated[
        str | None,
        typer.Option(help="shortest frame to show; at least that of the device and of the design"),
    ] = None,
    photons: options.Budget = None,
    dead_time: options.DeadTime = None,
    dead_time_model: options.DeadTimeModel = None,
    inputs: options.Inputs = None,
    marker: options.Marker = None,
    seed: options.CameraSeed = 0,
    yes: options.LargeFile = False,
    as_json: options.Json = False,
) -> None:
    """Show masks, count and choose the next dwells, scene after scene, with a design of looks.

    Prints each decision as it falls. Ctrl-C keeps the scenes that are finished.

    Example: deepfsi camera live patterns --scene images --exposure 10ms --flux 1e6 -o run_0002
    """
    paths.check_new_folder(out)
    virtual = _check_devices(context, projector, counter)
    if counter_config is not None:
        paths.check_there(counter_config, "counter configuration")
    if virtual and not (flux or 0.0) > 0:
        raise InputError("virtual devices need a flux above 0: give --flux, such as --flux 1e6")
    times, exposure_s = _latencies(latency or []), options.seconds("exposure", exposure)
    shortest_s = options.optional_seconds("shortest-dwell", shortest_dwell)
    from deepfsi.hardware.live.run import plan_live, run_live
    from deepfsi.hardware.recording.acquisition import Scene

    told: dict[str, Any] = {"flux": flux, **options.wiring(inputs, marker)}
    if dead := options.dead_time(dead_time, dead_time_model):
        told["dead_time"] = dead
    if virtual:
        told |= {"seed": seed, "camera": camera.find_camera(settings).model_dump(mode="json")}
    with _patterns(source, as_json) as patterns:
        images = camera.read_scenes(scene, patterns, True)
        labels: Sequence[str | None] = images.labels or [None] * len(images.names)
        scenes = tuple(
            Scene(name=name, label=label) for name, label in zip(images.names, labels, strict=True)
        )
        acquisition = plan_live(patterns, scenes, exposure_s, shortest_s, photons, until, **told)
        if virtual:
            if not yes:
                camera.ask_for_room(_events(patterns, images, acquisition))
            bench = _virtual(patterns, images, acquisition, times, as_json)
        else:
            bench = _real(counter, acquisition, images.names, counter_config, alp_version)
        table = _Table(acquisition, patterns, as_json)
        with contextlib.closing(run_live(out, patterns, acquisition, bench)) as decided:
            for each in decided:
                table.add(each)
        if counter == "followed":
            print("end the recording in the counter's software", file=sys.stderr)
    table.finish(out, images.preprocessing)


def _check_devices(context: typer.Context, projector: str, counter: str) -> bool:
    """True of virtual devices; `InputError` for devices or options that do not go together."""
    check_known("projector", projector, PROJECTORS)
    check_known("counter", counter, COUNTERS)
    virtual = projector == "virtual"
    if virtual != (counter == "virtual"):
        raise InputError("virtual and real devices do not go together: give both, or neither")
    chosen = f"--counter {counter}", "virtual devices" if virtual else f"--projector {projector}"
    words = {each.name: each.opts[0] for each in context.command.params}
    for parameter, owner in _OWN.items():
        if owner not in chosen and common.is_given(context, parameter):
            raise InputError(f"{words[parameter]} is for {owner}: leave it out")
    return virtual


@contextlib.contextmanager
def _patterns(source: Path, as_json: bool) -> Iterator[Path]:
    """Folder of patterns, or those of a design file for a DLP7000 in a folder for the moment."""
    if source.is_dir():
        yield source
        return
    from deepfsi.design.frames import design_rails
    from deepfsi.devices import find_device
    from deepfsi.hardware.patterns.folder import export_patterns
    from deepfsi.hardware.patterns.sequence import FrameSettings

    paths.check_design(source)
    with tempfile.TemporaryDirectory() as folder, common.progress("patterns", as_json) as report:
        patterns = Path(folder) / "patterns"
        frames = FrameSettings(find_device("dlp7000"), 1e-3)
        export_patterns(design_rails(source), frames, patterns, report)
        yield patterns


def _latencies(given: list[str]) -> "Latencies":
    """Latencies of virtual devices, of NAME=TIME."""
    from deepfsi.hardware.virtual.bench import Latencies

    times = {}
    for each in given:
        name, _, time = each.partition("=")
        check_known("latency", name, Latencies.model_fields)
        times[name] = options.seconds(f"latency {name}", time)
    with as_input_error():
        return Latencies(**times)


def _events(patterns: Path, images: "Display", planned: "Acquisition") -> float:
    """Photons and dark counts that a live run is expected to record, at most."""
    from deepfsi.hardware.patterns.folder import read_patterns
    from deepfsi.hardware.virtual.camera import VirtualCamera, expected_events

    seen = VirtualCamera.model_validate(planned.camera)
    known = read_patterns(patterns)
    passes = planned.exposure_s / known.manifest.pass_s + 1
    return expected_events(known, images.x, seen, planned.flux or 0.0) * passes


def _virtual(
    patterns: Path,
    images: "Display",
    acquisition: "Acquisition",
    times: "Latencies",
    as_json: bool,
) -> "Bench":
    """Virtual devices that see the scenes as a camera does."""
    from deepfsi.hardware.live.run import Bench
    from deepfsi.hardware.virtual.bench import BenchCounter, BenchProjector, VirtualSetup
    from deepfsi.hardware.virtual.camera import VirtualCamera, arrival_rates

    seen = VirtualCamera.model_validate(acquisition.camera)
    with common.progress("light of the scenes", quiet=as_json) as report:
        rates = arrival_rates(patterns, images.x, seen, acquisition.flux or 0.0, report)
    setup = VirtualSetup(rates, seen, times, acquisition.seed or 0)
    wiring = acquisition.inputs, acquisition.marker_bit
    return Bench(
        BenchProjector(setup),
        BenchCounter(setup, *wiring),
        setup.display,
        lambda: setup.now_s,
        times.model_dump(),
    )


def _real(
    counter: str,
    acquisition: "Acquisition",
    names: Sequence[str],
    config: Path | None,
    alp_version: str | None,
) -> "Bench":
    """A Vialux device and a counter; someone shows the scenes, whose names are asked for."""
    from deepfsi.hardware.drivers.followed import FollowedCounter
    from deepfsi.hardware.drivers.picoquant import SnapiCounter
    from deepfsi.hardware.drivers.vialux import VialuxLooks
    from deepfsi.hardware.live.run import Bench

    def display(scene: int) -> None:
        print(f"show {names[scene]}, then press Enter", file=sys.stderr, flush=True)
        if not sys.stdin.readline():
            raise InputError("nobody is there to show the scenes: run this in a terminal")

    def wait_for(path: Path, seconds: float) -> None:
        print(
            f"record {path} with the counter's software: begin within {seconds:g} s",
            file=sys.stderr,
        )

    wiring = acquisition.inputs, acquisition.marker_bit
    projector = VialuxLooks(alp_version) if alp_version else VialuxLooks()
    if counter == "followed":
        return Bench(projector, FollowedCounter(*wiring, waits=wait_for), display)
    return Bench(projector, SnapiCounter(*wiring, config=config), display)


class _Table:
    """Decisions as they fall, one line for each scene, and their sum."""

    def __init__(self, acquisition: "Acquisition", patterns: Path, as_json: bool) -> None:
        from deepfsi.hardware.live.networks import read_loop
        from deepfsi.hardware.patterns.folder import LOOP

        self._about = read_loop(patterns / LOOP).about
        self._acquisition, self._as_json = acquisition, as_json
        self._rows: list[dict[str, Any]] = []

    def add(self, each: "Decided") -> None:
        """Print a scene's last decision."""
        decision = each.decision
        if decision is not None and not decision.final:
            return
        scene = self._acquisition.scenes[each.scene]
        row = replays.describe(scene, decision, self._about.classes) | {"clock_s": each.clock_s}
        self._rows.append(row)
        if not self._as_json:
            print(_line(row, self._acquisition.exposure_s), flush=True)

    def finish(self, folder: Path, preprocessing: str) -> None:
        """Print the sum of all, or all as JSON; `InputError` if no scene has light."""
        if all(row["class"] is None for row in self._rows):
            raise InputError(
                f"no scene of {folder} has light: no all-ON frame is brighter than the all-OFF "
                "ones; check the lamp, the inputs and the counter's trigger levels, or export "
                "with a longer --dwell"
            )
        if self._as_json:
            common.print_json(
                "camera.live",
                {
                    "folder": str(folder),
                    "preprocessing": preprocessing,
                    "exposure_s": self._acquisition.exposure_s,
                    "scenes": self._rows,
                },
            )
            return
        print(f"scenes: {preprocessing}")
        replays.print_right(self._rows)
        used = sum(row["light_s"] for row in self._rows) / len(self._rows)
        clock = sum(row["clock_s"] for row in self._rows) / len(self._rows)
        print(
            f"light used {used / self._acquisition.exposure_s:.1%} of the exposures, clock time "
            f"{clock * 1e3:.4g} ms a scene\nrun: {folder}"
        )


def _line(row: dict[str, Any], exposure_s: float) -> str:
    """Answer for a scene in one line."""
    if row["class"] is None:
        return f"{row['scene']}: no light"
    looks = f"{row['looks']} look{'s' if row['looks'] > 1 else ''}"
    return (
        f"{row['scene']}: {row['class']}, confidence {row['probability']:.3f}, {looks}, light "
        f"{row['light_s'] * 1e3:.4g} ms ({row['light_s'] / exposure_s:.0%}), clock "
        f"{row['clock_s'] * 1e3:.4g} ms"
    )
