"""Acquisitions of a laboratory, prepared for the photon file that its counter will write."""

from pathlib import Path
from typing import Annotated, Any

import typer

from deepfsi.base import InputError, time_text
from deepfsi.cli import common, options, paths
from deepfsi.cli.camera import camera_of
from deepfsi.cli.settings import laboratory_fields, with_settings

_SERIES = "--cumulative or --bins"


@with_settings(laboratory_fields, "exposure", "flux")
def camera_prepare(
    patterns: Annotated[Path, typer.Argument(help="folder of patterns")],
    scenes: Annotated[
        Path,
        typer.Option(
            help="text file with NAME or NAME,LABEL on each line; or a folder of the pictures, "
            "with or without a folder for each class"
        ),
    ],
    settings: dict[str, Any],
    out: Annotated[Path, typer.Option("--out", "-o", help="acquisition folder, new")],
    inputs: options.Inputs = None,
    marker: options.Marker = None,
    settle: options.Settle = None,
    repeats: options.Repeats = None,
    as_json: options.Json = False,
) -> None:
    """Make the folder of a real acquisition; you then put the counter's photons.ptu into it.

    Exposure and flux are those of the design's camera unless given; the longest exposure that fits
    where it has none.

    Example: deepfsi camera prepare patterns --scenes scenes.csv --input 1 --marker 0 -o run_lab
    """
    paths.check_there(patterns, "a folder of patterns")
    paths.check_new_folder(out)
    from deepfsi.cli.scenes import listed
    from deepfsi.hardware.counting import Acquisition, prepare_run
    from deepfsi.hardware.light import name_inputs
    from deepfsi.hardware.patterns import read_patterns

    manifest = read_patterns(patterns).manifest
    known = camera_of(patterns, settings)
    planned = Acquisition.plan(
        manifest,
        listed(scenes, patterns),
        exposure_s=known.exposure,
        settle_s=options.optional_seconds("settle", settle),
        repeats=repeats,
        flux=known.flux,
        **options.wiring(inputs, marker),
    )
    made = prepare_run(out, patterns, planned)
    if as_json:
        common.print_json(
            "camera.prepare", {"folder": str(out), "acquisition": made.model_dump(mode="json")}
        )
        return
    print(
        f"{common.several(len(made.scenes), 'scene')}, {common.several(made.repeats, 'exposure')} "
        f"of {time_text(made.exposure_s)} for each, {time_text(manifest.pass_s)} a pass\n"
        f"photons on input {name_inputs(made.inputs)}, a trigger on marker input "
        f"{made.marker_bit.bit_length() - 1}\n"
        f"acquisition: {out}; show the patterns once for each scene, put the recording there as "
        f"photons.ptu, then: deepfsi camera count {out}"
    )


def camera_import(
    events: Annotated[
        Path,
        typer.Argument(
            help="time stamps: two columns, time and channel (.txt .csv .npy .parquet), or a "
            "Photon-HDF5 file; with --cumulative or --bins a table with a column for each input"
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", help="photon file, .ptu, new; with --cumulative or --bins a table, .csv"
        ),
    ],
    marker: Annotated[
        int | None,
        typer.Option(
            "--marker-channel",
            help="time stamps: channel of the device's trigger; none unless given",
        ),
    ] = None,
    channels: Annotated[
        list[int] | None,
        typer.Option(
            "--channel", help="channel of each detector, in order; all others unless given"
        ),
    ] = None,
    unit: Annotated[
        str | None, typer.Option(help="unit of the times, such as 1ps; the file's own unless given")
    ] = None,
    cumulative: Annotated[
        bool,
        typer.Option(
            "--cumulative", help="cumulative counts, latched by the trigger of each frame (NI)"
        ),
    ] = False,
    bins: Annotated[
        str | None,
        typer.Option(help="counts in even bins of this time, such as 100us (Hamamatsu units)"),
    ] = None,
    patterns: Annotated[
        Path | None, typer.Option(help="--cumulative and --bins: folder of the patterns shown")
    ] = None,
    passes: Annotated[
        int | None,
        typer.Option(min=1, help="--cumulative and --bins: passes; as many as there are"),
    ] = None,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Bring the data of another make of counter into a form that is read here.

    Time stamps become a photon file, their trigger marker 0. Without a trigger it has no markers,
    as for `camera transits`. Cumulative counts, and counts in even
    time bins, become a table with a row for each pass, for `camera classify`.

    Example: deepfsi camera import tags.txt --unit 81ps --marker-channel 8 -o run_lab/photons.ptu
    """
    if cumulative or bins:
        given = {"--marker-channel": marker, "--channel": channels, "--unit": unit}
        if stray := [option for option, value in given.items() if value is not None]:
            raise InputError(f"{stray[0]} is for time stamps: leave it out, or {_SERIES}")
        paths.check_file(out, (".csv",), force)
        _import_series(events, out, bins, patterns, passes, as_json)
        return
    if patterns is not None or passes is not None:
        raise InputError(f"--patterns and --passes are for {_SERIES}: leave them out")
    paths.check_file(out, (".ptu",), force)
    from deepfsi.hardware.photons import read_timestamps, summarise

    events_read = read_timestamps(events, options.optional_seconds("unit", unit))
    chosen = events_read.write(out, marker, tuple(channels) if channels else None)
    found = summarise(out)
    photons = {column + 1: found.photons.get(column, 0) for column in range(len(chosen))}
    triggers = found.markers.get(1, 0)
    left = len(events_read.times) - sum(photons.values()) - triggers
    if as_json:
        about = {"channels": chosen, "photons": photons, "markers": triggers, "left_out": left}
        about["span_s"] = found.span_s
        common.print_json("camera.import", {"file": str(out), **about})
        return
    for each, (column, many) in zip(chosen, photons.items(), strict=True):
        print(f"channel {each}: {many} photons on input {column}")
    if marker is None:
        print(f"no trigger, so no markers: give --marker-channel if a channel has it, or {_SERIES}")
    else:
        print(f"channel {marker}: {triggers} markers on 0")
    print(
        f"{left} events of other channels left out\n"
        f"time from the first event to the last: {found.span_s:.6g} s\nphotons: {out}"
    )


def _import_series(
    source: Path,
    out: Path,
    bins: str | None,
    patterns: Path | None,
    passes: int | None,
    as_json: bool,
) -> None:
    """Write cumulative counts, or counts in bins, as a table."""
    if patterns is None:
        raise InputError(f"{_SERIES} need the patterns that were shown: give --patterns")
    from deepfsi.base import write_atomically
    from deepfsi.base.numeric import read_table
    from deepfsi.hardware.counting import table_of_series
    from deepfsi.hardware.patterns import read_patterns

    manifest, values = read_patterns(patterns).manifest, read_table(source).values
    width = options.optional_seconds("bins", bins)
    rows, names = table_of_series(values, manifest, bin_s=width, passes=passes, name=str(source))
    lines = [",".join(names), *(",".join(map(str, row)) for row in rows.tolist())]
    write_atomically(out, "\n".join([*lines, ""]).encode())
    settle = [] if bins is None else ["--settle", bins]
    ends = [] if "on" in {each.split("/")[0] for each in names} else ["--photons", "--background"]
    if as_json:
        about = {"passes": len(rows), "values": len(names), "settle_s": width or 0.0}
        common.print_json("camera.import", {"file": str(out), **about, "needs": ends})
        return
    print(f"{len(rows)} passes of {len(names)} values\ntable: {out}")
    if ends:
        print(
            "the last frame of a pass has no end: all-ON and all-OFF frames are left out; give "
            f"{' and '.join(ends)} to classify"
        )
    print("then:", *("deepfsi camera classify", patterns, out, *settle))
