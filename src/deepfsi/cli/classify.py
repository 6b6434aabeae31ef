"""Classes of exposures from counts: of an acquisition's folder, or a table of any counter."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from deepfsi.cli import common, options, paths, replays
from deepfsi.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from deepfsi.design.artifact import Design
    from deepfsi.hardware.recording.acquisition import Scene
    from deepfsi.hardware.recording.counts import Counts
    from deepfsi.hardware.recording.tables import TableSettings


class _Exposures(NamedTuple):
    """Counted exposures, their scenes, and the design as it was shown."""

    counts: "Counts"
    scenes: "Sequence[Scene]"
    made: "Design"


def camera_classify(
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
        float | None,
        typer.Option(
            help="table: dark counts of an input in one exposure; those of the all-OFF frames "
            "unless given"
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
    dead_time: Annotated[
        str | None, typer.Option(help="table: correct for this dead time of the counter")
    ] = None,
    dead_time_model: options.DeadTimeModel = None,
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
    paths.check_design(file)
    import numpy as np

    from deepfsi.cli.consistency import check_counts
    from deepfsi.optics.budget import check_budget

    if photons is not None:
        check_budget(photons)
    options_of_tables = {
        "background": background, "settle": settle, "exposures": exposures, "gain": gain,
        "read-noise": read_noise, "dead-time": dead_time, "dead-time-model": dead_time_model,
        "repeats": None if repeats == 1 else repeats,
    }  # fmt: skip
    if _is_run(counted):
        given = [name for name, value in options_of_tables.items() if value is not None]
        if given:
            raise InputError(f"--{given[0]} is for tables, and {counted} is a folder: leave it out")
        if replays.is_live(counted):
            replays.print_live_classes(_design_file(file), counted, photons, as_json)
            return
        counts, listed, made = _of_run(file, counted, trust)
    else:
        from deepfsi.hardware.recording.dead_time import NO_DEAD_TIME
        from deepfsi.hardware.recording.tables import TableSettings

        settle_s = options.optional_seconds("settle", settle) or 0.0
        dead = options.dead_time(dead_time, dead_time_model) or NO_DEAD_TIME
        settings = TableSettings(
            photons, background, settle_s, exposures, repeats, gain, read_noise, dead
        )
        counts, listed, made = _of_table(file, counted, settings, trust)
    usable = counts.valid & ~counts.spoilt[:, None]
    if not usable.any():
        raise InputError(
            f"{counted} has no exposure that can be classified ({counts.faults[0]}): record again"
        )
    budgets = np.where(
        np.isfinite(counts.photons), counts.photons if photons is None else photons, 1.0
    )
    tested = check_counts(made, counts, usable, budgets, force)
    probabilities = made.classify(made.readouts(counts.signal()), budgets[:, None])
    scenes = []
    for place, scene in enumerate(listed):
        about = {
            "photons": float(budgets[place]) if usable[place].any() else None,
            "faults": [str(fault) for fault in counts.faults_of(place)],
            **tested.scenes[place],
        }
        guessed = _guessed(probabilities[place][usable[place]], made.classes)
        scenes.append({"scene": scene.name, "label": scene.label, **guessed, **about})
    if as_json:
        common.print_json("camera.classify", {"consistency": tested.summary, "scenes": scenes})
        return
    _print_classes(f"{made.name}, {made.masks} masks", scenes, counts, made.classes)
    for remark in tested.remarks:
        print(remark)


def _is_run(counted: Path) -> bool:
    """True for a folder, False for a table, or `InputError`."""
    from deepfsi.tables.table_files import SUFFIXES, is_table

    if counted.is_dir():
        return True
    if is_table(counted):
        return False
    raise InputError(
        f"{counted} is nothing that was counted: give an acquisition folder, with photons.ptu in "
        f"it, or a table ending in {', '.join(SUFFIXES)}"
    )


def _of_run(file: Path, folder: Path, trust: bool) -> _Exposures:
    """Exposures of an acquisition's folder."""
    from deepfsi.hardware.recording.acquisition import read_acquisition
    from deepfsi.hardware.recording.counts import load_counts

    acquisition, patterns = read_acquisition(folder)
    counts = load_counts(folder, acquisition, patterns.manifest)
    made = _open(file, trust)
    replays.check_shown(_design_file(file), patterns.manifest)
    return _Exposures(counts, acquisition.scenes, made.as_shown(*patterns.realised))


def _of_table(file: Path, table: Path, settings: "TableSettings", trust: bool) -> _Exposures:
    """Exposures of a table of counts."""
    from deepfsi.design.frames import design_rails
    from deepfsi.hardware.patterns.folder import read_patterns
    from deepfsi.hardware.patterns.nominal import nominal_manifest
    from deepfsi.hardware.recording.tables import WORDS, count_table
    from deepfsi.tables.table_files import read_table

    made = _open(file, trust)
    if file.is_dir():
        patterns = read_patterns(file)
        manifest = patterns.manifest
        replays.check_shown(_design_file(file), manifest)
        made = made.as_shown(*patterns.realised)
    else:
        if settings.settle_s or settings.dead_time.seconds:
            raise InputError(
                f"--settle and --dead-time need the times of the frames, and {file} has none: give "
                "the folder of its patterns"
            )
        manifest = nominal_manifest(design_rails(file))
    counts, scenes = count_table(read_table(table, WORDS), manifest, settings, str(table))
    return _Exposures(counts, scenes, made)


def _design_file(file: Path) -> Path:
    """Design file of a design file, or of a folder of patterns."""
    return file / "design.safetensors" if file.is_dir() else file


def _open(file: Path, trust: bool) -> "Design":
    """Design of a file or a folder of patterns, with dwells that are fixed."""
    from deepfsi.design.artifact import Design

    made = Design.load(_design_file(file), trust=trust)
    if made.exposure.looks > 1:
        raise InputError(f"{file} chooses dwells while the exposure runs: give a live run of it")
    return made


def _guessed(chances: "np.ndarray", classes: tuple[str, ...]) -> dict[str, Any]:
    """Class of a scene from the probabilities (R, C) of its exposures, for JSON."""
    mean = chances.mean(axis=0) if len(chances) else None
    return {
        "class": None if mean is None else classes[mean.argmax()],
        "probability": None if mean is None else float(mean.max()),
        "exposures": len(chances),
        "guesses": [classes[k] for k in chances.argmax(axis=-1)],
    }


def _print_classes(
    title: str, scenes: list[dict[str, Any]], counts: "Counts", classes: tuple[str, ...]
) -> None:
    rows = [
        (
            str(s["scene"]),
            str(s["class"] or "none"),
            f"{s['probability']:.3f}" if s["probability"] is not None else "",
            f"{s['guesses'].count(s['class'])} of {len(s['guesses'])}" if s["guesses"] else "",
            str(s["label"] or ""),
            ", ".join(
                sorted({fault.kind for fault in counts.faults_of(place)})
                + ["unsure"] * bool(s["unsure"])
            ),
        )
        for place, s in enumerate(scenes)
    ]
    heads = ("scene", "class", "mean probability", "of its exposures", "labelled", "remarks")
    common.print_table(title, heads, rows)
    for fault in counts.faults:
        print(fault.line([str(s["scene"]) for s in scenes]))
    labelled = [(g, s["label"]) for s in scenes if s["label"] for g in s["guesses"]]
    known = [(guess, label) for guess, label in labelled if label in classes]
    if known:
        right = sum(guess == label for guess, label in known)
        print(f"right: {right} of {len(known)} exposures")
    if foreign := len(labelled) - len(known):
        print(f"{foreign} exposures have labels that are none of the design's classes: left out")
