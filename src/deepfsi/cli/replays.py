"""Live runs after their end: counts, and decisions replayed."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepfsi.cli import common
from deepfsi.errors import InputError

if TYPE_CHECKING:
    from deepfsi.hardware.live.decisions import Decision
    from deepfsi.hardware.patterns.sequence import Manifest
    from deepfsi.hardware.recording.acquisition import Scene


def describe(
    scene: "Scene", decision: "Decision | None", classes: tuple[str, ...]
) -> dict[str, Any]:
    """Answer for a scene, for JSON."""
    row = {"scene": scene.name, "label": scene.label}
    if decision is None:
        none = {"class": None, "probability": None, "looks": 0, "photons": None, "light_s": 0.0}
        return row | none
    return row | {
        "class": classes[decision.chances.argmax()],
        "probability": float(decision.chances.max()),
        "looks": decision.look + 1,
        "photons": decision.photons,
        "light_s": decision.light_s,
    }


def print_right(rows: list[dict[str, Any]]) -> None:
    """Say how many of the labelled scenes are right."""
    known = [row for row in rows if row["label"] is not None]
    if known:
        right = sum(row["class"] == row["label"] for row in known)
        print(f"right: {right} of {len(known)} scenes")


def is_live(folder: Path) -> bool:
    """True for the folder of a live run, which has a record of its frames."""
    from deepfsi.hardware.live import shown

    return (folder / shown.NAME).exists()


def check_as_it_was(given: "Sequence[object]") -> None:
    """Raise `InputError` if a live run is to be counted or classified otherwise than it was."""
    if any(each is not None for each in given):
        raise InputError(
            "a live run is counted and classified as it was: its looks followed from these counts; "
            "leave the options out"
        )


def check_shown(file: Path, manifest: "Manifest") -> None:
    """Raise `InputError` where the patterns are known to be of another design than a file's."""
    from deepfsi.hardware.recording.counts import hash_file

    known = manifest.design_sha256
    if (known or manifest.looks) and hash_file(file) != known:
        raise InputError(
            f"{file} is not the design whose patterns were shown: give the file that "
            "`deepfsi dmd export` was given"
        )


def print_live_counts(folder: Path, as_json: bool) -> None:
    """Count a live run, and say what was counted."""
    from deepfsi.hardware.live.replay import count_live

    with common.progress("counting", quiet=as_json) as report:
        counts = count_live(folder, report)
    summary = {
        "scenes": len(counts.scenes),
        "looks": sum(each.looks for each in counts.scenes),
        "frames": len(counts.counts),
        "photons_counted": int(counts.counts.sum()),
    }
    if as_json:
        rows = [
            [{"look": part.look, "frames": part.frames, "counts": found.tolist()}
             for part, found in zip(scene.lists, lists, strict=True)]
            for scene, lists in counts.by_scene
        ]  # fmt: skip
        common.print_json("camera.count", {**summary, "counts": rows})
        return
    print(
        f"a live run: {summary['scenes']} scenes, {summary['looks']} looks, {summary['frames']} "
        f"frames\n{summary['photons_counted']} photons counted\n"
        f"counts: {folder / 'counts.npz'}"
    )


def print_live_classes(file: Path, folder: Path, photons: float | None, as_json: bool) -> None:
    """Replay the decisions of a live run from its counts, and compare them with the run's.

    Photons are counted first where that was not done.
    """
    from deepfsi.hardware.live.networks import read_loop
    from deepfsi.hardware.live.replay import COUNTS, count_live, replay_run
    from deepfsi.hardware.patterns.folder import LOOP
    from deepfsi.hardware.recording.acquisition import read_acquisition

    acquisition, patterns = read_acquisition(folder)
    check_as_it_was((photons,))
    check_shown(file, patterns.manifest)
    if not (folder / COUNTS).exists():
        with common.progress("counting", quiet=as_json) as report:
            count_live(folder, report)
    classes = read_loop(folder / "patterns" / LOOP).about.classes
    rows = []
    for each, scene in zip(replay_run(folder), acquisition.scenes, strict=False):
        last = each.decisions[-1] if each.decisions else None
        row = describe(scene, last, classes)
        rows.append(row | {"clock_s": each.shown.clock_s, "agrees": each.agrees})
    if as_json:
        common.print_json("camera.classify", {"live": True, "scenes": rows})
        return
    heads = ("scene", "class", "confidence", "looks", "light", "labelled")
    lines = [
        (
            str(row["scene"]),
            str(row["class"] or "none"),
            "" if row["class"] is None else f"{row['probability']:.3f}",
            str(row["looks"]),
            f"{row['light_s'] / acquisition.exposure_s:.0%}",
            str(row["label"] or ""),
        )
        for row in rows
    ]
    common.print_table("a live run, replayed from its counts", heads, lines)
    print_right(rows)
    agree = sum(row["agrees"] for row in rows)
    print(f"as decided in the run, bit for bit: {agree} of {len(rows)} scenes")
