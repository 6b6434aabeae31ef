"""Recorded runs of a fixed design: a projector and a counter, scene after scene, then counted."""

import contextlib
from pathlib import Path
from typing import Annotated, Any

import typer

from deepfsi.cli import camera, common, live, options, paths
from deepfsi.cli.settings import COUNTER_EFFECTS, laboratory_fields, with_settings


@with_settings(laboratory_fields, "exposure", "flux", "dark", *COUNTER_EFFECTS)
def camera_record(
    context: typer.Context,
    settings: dict[str, Any],
    patterns: Annotated[Path, typer.Argument(help="folder of patterns")],
    scene: Annotated[
        Path,
        typer.Option(
            help="picture, folder or .zip of the scenes; with real devices also a text file with "
            "NAME or NAME,LABEL on each line"
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="acquisition folder, new")],
    projector: options.Projector = "virtual",
    counter: options.Counter = "virtual",
    counter_config: options.CounterConfig = None,
    marker_channel: options.MarkerChannel = None,
    alp_version: options.AlpVersion = None,
    virtual: options.Virtual = None,
    latency: options.Latency = None,
    settle: options.Settle = None,
    repeats: options.Repeats = None,
    inputs: options.Inputs = None,
    marker: options.Marker = None,
    seed: options.CameraSeed = 0,
    yes: options.LargeFile = False,
    as_json: options.Json = False,
) -> None:
    """Show a pass of all frames for each scene, record, count, and name every fault.

    Prints a line for each scene as it is recorded. Ctrl-C keeps the scenes that are finished.

    Example: deepfsi camera record patterns --scene images --exposure 10ms --flux 1e7 -o run_0001
    """
    paths.check_there(patterns, "a folder of patterns")
    paths.check_new_folder(out)
    simulated = live.check_devices(context, projector, counter, settings)
    if counter_config is not None:
        paths.check_there(counter_config, "counter configuration")
    times = live.latencies_of(latency or [])
    from deepfsi.base import SILENT
    from deepfsi.cli.scenes import listed, scenes_of
    from deepfsi.hardware.counting import Acquisition, CountSettings, count_run
    from deepfsi.hardware.drivers import (
        DeviceSettings,
        PassProjector,
        Setup,
        open_counter,
        open_projector,
    )
    from deepfsi.hardware.live import record_run
    from deepfsi.hardware.patterns import read_patterns
    from deepfsi.hardware.virtual import expected_events, virtual_setup
    from deepfsi.lab import displayed

    shown = read_patterns(patterns)
    known = camera.camera_of(patterns, settings)
    told = {"flux": known.flux, **options.wiring(inputs, marker)}
    if simulated:
        flux = camera.flux_of(known)
        images, seen = displayed(scene, patterns), camera.find_camera(virtual, patterns, settings)
        told |= {"seed": seed, "camera": seen.model_dump(mode="json")}
        if not yes:
            camera.ask_for_room(expected_events(shown, images.x, seen, flux))
    acquisition = Acquisition.plan(
        shown.manifest,
        scenes_of(images, scene, patterns) if simulated else listed(scene, patterns),
        exposure_s=known.exposure,
        settle_s=options.optional_seconds("settle", settle),
        repeats=repeats,
        **told,
    )
    setup: Setup[PassProjector]
    if simulated:
        with common.progress("light of the scenes", quiet=as_json) as report:
            setup = virtual_setup(patterns, images.x, acquisition, times, report)
    else:
        devices = DeviceSettings(
            acquisition.inputs,
            acquisition.marker_bit,
            counter_config=counter_config,
            marker_channel=marker_channel,
            alp_version=alp_version,
            ask_to_record=live.ask_to_record,
        )
        setup = Setup(
            open_projector(projector, devices),
            open_counter(counter, devices),
            live.ask_for_scenes(acquisition),
        )
    told_load = SILENT if as_json else None
    with contextlib.closing(record_run(out, patterns, acquisition, setup, told_load)) as recorded:
        for each in recorded:
            if not as_json:
                print(
                    f"{each.scene.name}: {each.masks_rate:.4g} counts/s in the masks' frames, all "
                    f"ON {each.on_rate:.4g}, all OFF {each.off_rate:.4g}"
                    f"{'' if each.lit else ': NO LIGHT'}",
                    flush=True,
                )
    if counter == "followed":
        live.ask("end the recording in the counter's software")
    effects = known.counter_effects(settings)
    clicks = camera.camera_of(patterns).clicks
    with common.progress("counting", quiet=as_json) as report:
        counts = count_run(out, CountSettings(effects=effects, clicks=clicks), progress=report)
    camera.print_counts(counts, out, as_json, "camera.record")
    if not as_json:
        print(f"run: {out}; then: deepfsi camera classify {patterns} {out}")
