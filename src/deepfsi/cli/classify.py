"""Classes of exposures from counts: of an acquisition's folder, or a table of any counter."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.base import InputError
from deepfsi.cli import common, options, paths
from deepfsi.cli.settings import COUNTER_EFFECTS, laboratory_fields, with_settings

if TYPE_CHECKING:
    from deepfsi.hardware.live import LiveAnswers
    from deepfsi.lab import ClassifiedRun, ClassifiedScene


@with_settings(laboratory_fields, *COUNTER_EFFECTS)
def camera_classify(
    settings: dict[str, Any],
    file: Annotated[
        Path,
        typer.Argument(help="design file whose patterns were shown, or the folder of its patterns"),
    ],
    counted: Annotated[
        Path,
        typer.Argument(
            metavar="RUN|TABLE",
            help="acquisition folder that was counted; or counts of any counter, .csv .parquet "
            ".npy .mat .h5 (FILE:VARIABLE), a row for each exposure",
        ),
    ],
    photons: options.Budget = None,
    background: Annotated[
        str | None,
        typer.Option(
            help="table: dark counts of an input in one exposure, those of the all-OFF frames "
            "unless given; or a table of exposures with the scene dark, to be subtracted"
        ),
    ] = None,
    settle: Annotated[
        str | None,
        typer.Option(help="table: time after each marker without counting; 0 unless given"),
    ] = None,
    exposures: Annotated[
        str | None,
        typer.Option(help="table: exposures are rows or columns; by its shape unless given"),
    ] = None,
    repeats: Annotated[
        int, typer.Option(min=1, help="table: number of consecutive exposures of each scene")
    ] = 1,
    gain: Annotated[
        float | None,
        typer.Option(help="table of an analogue detector: counts that one unit stands for"),
    ] = None,
    read_noise: Annotated[
        float | None,
        typer.Option(help="table of an analogue detector: read noise of a value, counts rms"),
    ] = None,
    trust: options.Trust = False,
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="classify even if the counts do not look like those of the training"
        ),
    ] = False,
    as_json: options.Json = False,
) -> None:
    """Classify each exposure of a counted acquisition, or of a table of counts.

    Counts that do not look like what the design was trained for are refused, and single scenes
    that do not are unsure. A table has a value for each frame, in the order of the patterns.

    Example: deepfsi camera classify one-dmd.safetensors run_0001
    """
    file = paths.check_design(file)
    options_of_tables = {
        "background": background, "settle": settle, "exposures": exposures, "gain": gain,
        "read-noise": read_noise, "repeats": None if repeats == 1 else repeats,
        **{name.replace("_", "-"): value for name, value in settings.items()},
    }  # fmt: skip
    from deepfsi.base.numeric import TABLE_ENDINGS, is_table, read_table
    from deepfsi.hardware.live import LiveCounts, is_live
    from deepfsi.lab import ClassifiedRun, classify_run, classify_table

    found: ClassifiedRun | LiveAnswers
    if counted.is_dir():
        given = [name for name, value in options_of_tables.items() if value is not None]
        if given:
            raise InputError(f"--{given[0]} is for tables, and {counted} is a folder: leave it out")
        if is_live(counted) and not (counted / LiveCounts.NAME).exists():
            with common.progress("counting", quiet=as_json) as report:
                LiveCounts.count(counted, report)
        found = classify_run(file, counted, photons=photons, force=force, trust=trust)
    elif is_table(counted):
        from deepfsi.hardware.counting import TableSettings

        settle_s = options.optional_seconds("settle", settle) or 0.0
        dark = (
            read_table(background, TableSettings.WORDS)
            if background and is_table(background)
            else None
        )
        counts = None if background is None or dark else options.number("background", background)
        table = TableSettings(
            *(photons, counts, settle_s, exposures, repeats, gain, read_noise), dark=dark
        )
        found = classify_table(file, counted, table, camera=settings, force=force, trust=trust)
    else:
        raise InputError(
            f"{counted} is nothing that was counted: give an acquisition folder, with photons.ptu "
            f"in it, or a table ending in {', '.join(TABLE_ENDINGS)}"
        )
    if as_json:
        common.print_json("camera.classify", found.as_dict())
    elif isinstance(found, ClassifiedRun):
        _print_classes(found)
    else:
        _print_replay(found)


def _print_classes(found: "ClassifiedRun") -> None:
    several = any(scene.exposures > 1 for scene in found.scenes)
    rows = [
        (
            scene.name,
            scene.predicted or "none",
            "" if scene.probability is None else f"{scene.probability:.3f}",
            *([_agreeing(scene)] if several else []),
            scene.label or "",
            ", ".join(
                sorted({fault.kind for fault in scene.faults}) + ["unsure"] * bool(scene.unsure)
            ),
        )
        for scene in found.scenes
    ]
    told = ["mean probability", "of its exposures"] if several else ["probability"]
    heads = ("scene", "class", *told, "labelled", "remarks")
    common.print_table(f"{found.design}, {found.masks} masks", heads, rows)
    for fault in found.faults:
        print(fault.line([scene.name for scene in found.scenes]))
    for remark in found.remarks:
        print(common.as_options(remark))
    labelled = sum(len(scene.guesses) for scene in found.scenes if scene.label)
    if foreign := labelled - found.score.answers:
        print(f"{foreign} exposures have labels that are none of the design's classes: left out")
    for line in found.score.lines("exposure"):
        print(line)


def _agreeing(scene: "ClassifiedScene") -> str:
    """Number of exposures of a scene that have its class."""
    if not scene.predicted:
        return ""
    return f"{scene.guesses.count(scene.predicted)} of {scene.exposures}"


def _print_replay(found: "LiveAnswers") -> None:
    heads = ("scene", "class", "confidence", "looks", "light", "labelled", "remarks")
    rows = [
        (
            scene.name,
            scene.predicted or "none",
            "" if scene.probability is None else f"{scene.probability:.3f}",
            str(scene.looks),
            f"{scene.light_s / found.exposure_s:.0%}",
            scene.label or "",
            ", ".join(sorted({fault.kind for fault in scene.faults})),
        )
        for scene in found.scenes
    ]
    common.print_table("a live run, replayed from its counts", heads, rows)
    names = [scene.name for scene in found.scenes]
    for fault in (fault for scene in found.scenes for fault in scene.faults):
        print(common.as_options(fault.words(names)))
    print_right(found)
    agree = sum(bool(scene.agrees) for scene in found.scenes)
    print(f"as decided in the run, bit for bit: {agree} of {len(rows)} scenes")


def print_right(found: "LiveAnswers") -> None:
    """Say how many scenes of a live run have no class, how many are right, and how it saw them."""
    none = sum(scene.predicted is None for scene in found.scenes)
    if none:
        print(f"no class: {none} of {len(found.scenes)} scenes")
    for line in found.score.lines("scene"):
        print(line)
    if found.view is not None and found.view.remark:
        print(common.as_options(found.view.remark))
