"""Live runs: a projector and a counter that show, count and decide; and their replay."""

import contextlib
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.base import InputError, as_input_error, check_choice
from deepfsi.cli import camera, common, options, paths
from deepfsi.cli.classify import print_right
from deepfsi.cli.settings import COUNTER_EFFECTS, laboratory_fields, with_settings

if TYPE_CHECKING:
    from deepfsi.hardware.counting import Acquisition
    from deepfsi.hardware.live import LiveAnswers, LiveScene
    from deepfsi.hardware.virtual import Latencies

VIRTUAL_SETTINGS = ("flux", "dark", "virtual", "latency", "seed", "yes")
"""Parameters that only virtual devices take."""


@with_settings(laboratory_fields, "exposure", "flux", "dark", *COUNTER_EFFECTS, "shortest_dwell")
def camera_live(
    context: typer.Context,
    settings: dict[str, Any],
    source: Annotated[
        Path, typer.Argument(help="folder of patterns; or a design file, shown on a DLP7000")
    ],
    scene: options.Scenes,
    out: Annotated[Path, typer.Option("--out", "-o", help="acquisition folder, new")],
    projector: options.Projector = "virtual",
    counter: options.Counter = "virtual",
    counter_config: options.CounterConfig = None,
    marker_channel: options.MarkerChannel = None,
    alp_version: options.AlpVersion = None,
    virtual: options.Virtual = None,
    latency: options.Latency = None,
    until: Annotated[
        float | None,
        typer.Option(
            help="confidence above which an exposure stops; that of the design's rule unless given"
        ),
    ] = None,
    photons: options.Budget = None,
    background: Annotated[
        bool,
        typer.Option(
            "--background",
            help="first show all masks with the scenes dark, and subtract what they count",
        ),
    ] = False,
    inputs: options.Inputs = None,
    marker: options.Marker = None,
    seed: options.CameraSeed = 0,
    yes: options.LargeFile = False,
    as_json: options.Json = False,
) -> None:
    """Show masks, count and choose what is shown next, scene after scene.

    A design of several looks chooses the next dwells, a design of adaptive masks makes the next
    mask.

    Prints each decision when it is made. Ctrl-C keeps the scenes that are finished.

    Example: deepfsi camera live patterns --scene images --exposure 10ms --flux 1e6 -o run_0002
    """
    paths.check_new_folder(out)
    simulated = check_devices(context, projector, counter, settings)
    if counter_config is not None:
        paths.check_there(counter_config, "counter configuration")
    times, source = latencies_of(latency or []), paths.check_design(source)
    from deepfsi.cli.scenes import scenes_of
    from deepfsi.hardware.drivers import (
        DeviceSettings,
        Setup,
        StreamingProjector,
        open_counter,
        open_list_projector,
    )
    from deepfsi.hardware.live import LiveAnswers, plan_live, run_live
    from deepfsi.hardware.patterns import read_patterns
    from deepfsi.hardware.virtual import expected_events, virtual_setup
    from deepfsi.lab import displayed, open_looks

    devices = DeviceSettings(
        counter_config=counter_config,
        marker_channel=marker_channel,
        alp_version=alp_version,
        ask_to_record=ask_to_record,
    )
    real = None if simulated else open_list_projector(projector, devices)
    known = camera.camera_of(source, settings)
    exposure_s = camera.exposure_of(known)
    told: dict[str, Any] = {"flux": known.flux, "background": background}
    told |= options.wiring(inputs, marker)
    if effects := known.counter_effects(settings):
        told["effects"] = effects
    if simulated:
        camera.flux_of(known)
        seen = camera.find_camera(virtual, source, settings)
        told |= {"seed": seed, "camera": seen.model_dump(mode="json")}
    with _patterns(source, as_json) as patterns:
        images = displayed(scene, patterns)
        looks = open_looks(patterns)
        acquisition = plan_live(
            patterns,
            scenes_of(images, scene, patterns),
            exposure_s,
            known.shortest_dwell or None,
            looks=looks,
            photons=photons,
            until=until,
            **told,
        )
        setup: Setup[StreamingProjector]
        if real is None:
            if not yes:
                shown = read_patterns(patterns)
                passes = exposure_s / shown.manifest.pass_s + 1  # at most
                events = expected_events(shown, images.x, seen, known.flux or 0.0)
                camera.ask_for_room(events * passes)
            with common.progress("light of the scenes", quiet=as_json) as report:
                setup = virtual_setup(
                    patterns, images.x, acquisition, times, report, decision_s=looks.decision_s
                )
        else:
            wired = replace(devices, inputs=acquisition.inputs, marker_bit=acquisition.marker_bit)
            setup = Setup(real, open_counter(counter, wired), ask_for_scenes(acquisition))
        answers, decisions = [], []
        with contextlib.closing(run_live(out, patterns, acquisition, setup, looks)) as steps:
            for step in steps:
                if step.answer is None:
                    continue
                answers.append(step.answer)
                decisions.append(step.decision)
                if not as_json:
                    print(_line(step.answer, exposure_s), flush=True)
        if counter == "followed":
            print("end the recording in the counter's software", file=sys.stderr)
    about = {"folder": str(out), "preprocessing": images.preprocessing, "exposure_s": exposure_s}
    _print_run(LiveAnswers.of(exposure_s, answers, decisions), about, as_json)


def check_devices(
    context: typer.Context, projector: str, counter: str, settings: dict[str, Any]
) -> bool:
    """True of virtual devices; `InputError` for devices or options that do not go together."""
    from deepfsi.hardware.drivers import COUNTERS, PROJECTORS

    check_choice("projector", projector, ("virtual", *PROJECTORS))
    check_choice("counter", counter, ("virtual", *COUNTERS))
    virtual = projector == "virtual"
    if virtual != (counter == "virtual"):
        raise InputError("virtual and real devices do not go together: give both, or neither")
    takers: dict[str, list[str]] = {name: ["virtual devices"] for name in VIRTUAL_SETTINGS}
    for option, drivers in (("--counter", COUNTERS), ("--projector", PROJECTORS)):
        for name, driver in drivers.items():
            for parameter in driver.settings:
                takers.setdefault(parameter, []).append(f"{option} {name}")
    chosen = {f"--counter {counter}", "virtual devices" if virtual else f"--projector {projector}"}
    words = {each.name: each.opts[0] for each in context.command.params}
    for parameter, devices in takers.items():
        given = parameter in settings or common.is_given(context, parameter)
        if given and not chosen & set(devices):
            raise InputError(f"{words[parameter]} is for {' or '.join(devices)}: leave it out")
    return virtual


@contextlib.contextmanager
def _patterns(source: Path, as_json: bool) -> Iterator[Path]:
    """Folder of patterns, or those of a design file for the moment."""
    if source.is_dir():
        yield source
        return
    from deepfsi.camera import find_device
    from deepfsi.hardware.patterns import FrameSettings, export_patterns
    from deepfsi.lab import design_rails

    with tempfile.TemporaryDirectory() as folder:
        patterns = Path(folder) / "patterns"
        with common.progress("patterns", as_json) as report:
            frames = FrameSettings(find_device("dlp7000"), 1e-3)
            export_patterns(design_rails(source), frames, patterns, report)
        yield patterns


def latencies_of(given: list[str]) -> "Latencies":
    """Latencies of virtual devices, of NAME=TIME."""
    from deepfsi.hardware.virtual import Latencies

    times = {}
    for each in given:
        name, _, time = each.partition("=")
        check_choice("latency", name, Latencies.model_fields)
        times[name] = options.seconds(f"latency {name}", time)
    with as_input_error():
        return Latencies(**times)


def ask_for_scenes(acquisition: "Acquisition") -> Callable[[int], None]:
    """Display of a run with real devices: someone shows the scenes, whose names are asked for."""

    def display(scene: int) -> None:
        ask(f"show {acquisition.scenes[scene].name}" if scene >= 0 else "make the scenes dark")

    return display


def ask_to_record(path: Path, seconds: float) -> None:
    """Ask someone to record a file with the counter's software."""
    print(f"record {path} with the counter's software: begin within {seconds:g} s", file=sys.stderr)


def ask(what: str) -> None:
    """Ask someone to do something, and wait until it is done."""
    print(f"{what}, then press Enter", file=sys.stderr, flush=True)
    if not sys.stdin.readline():
        raise InputError("nobody is there to show the scenes: run this in a terminal")


def _print_run(answers: "LiveAnswers", about: dict[str, Any], as_json: bool) -> None:
    """Print the sum of all scenes, or all as JSON; `InputError` if none has light."""
    folder, scenes = about["folder"], answers.scenes
    if not any(scene.looks for scene in scenes):
        raise InputError(
            f"no scene of {folder} has light: no all-ON frame is brighter than the all-OFF "
            "ones; check the lamp, the inputs and the counter's trigger levels, or export "
            "with a longer --exposure"
        )
    if all(scene.predicted is None for scene in scenes):
        first = next(fault for scene in scenes for fault in scene.faults)
        raise InputError(
            "no scene of {folder} has a class: {fault}", folder=folder, fault=first.words()
        )
    if as_json:
        content = answers.as_dict()
        del content["live"]  # as every run of this command is
        common.print_json("camera.live", {**about, **content})
        return
    print(f"scenes: {about['preprocessing']}")
    print_right(answers)
    used = sum(scene.light_s for scene in scenes) / len(scenes)
    clock = sum(scene.clock_s for scene in scenes) / len(scenes)
    print(
        f"light used {used / answers.exposure_s:.1%} of the exposures, clock time "
        f"{clock * 1e3:.4g} ms a scene\nrun: {folder}"
    )


def _line(scene: "LiveScene", exposure_s: float) -> str:
    """Answer for a scene in one line, and one more for each of its faults."""
    if not scene.looks:
        return f"{scene.name}: no light"
    faults = "".join(f"\n  {common.as_options(fault.words())}" for fault in scene.faults)
    if scene.predicted is None:
        return f"{scene.name}: no class{faults}"
    looks = f"{scene.looks} look{'s' if scene.looks > 1 else ''}"
    return (
        f"{scene.name}: {scene.predicted}, confidence {scene.probability:.3f}, {looks}, light "
        f"{scene.light_s * 1e3:.4g} ms ({scene.light_s / exposure_s:.0%}), clock "
        f"{scene.clock_s * 1e3:.4g} ms{faults}"
    )
