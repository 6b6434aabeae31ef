"""Command of scenes that pass a pattern: transits found in a photon file, and their classes."""

from pathlib import Path
from typing import Annotated

import typer

from deepfsi.base import time_text
from deepfsi.cli import common, options, paths


def camera_transits(
    design: Annotated[Path, typer.Argument(help="design file of scenes that pass a pattern")],
    file: Annotated[Path, typer.Argument(metavar="PTU", help="photon file, without markers")],
    bins: Annotated[str, typer.Option("--bin", help="length of a time bin, such as 100us")],
    photons: Annotated[
        float | None, typer.Option(help="budget of a transit; that of the training unless given")
    ] = None,
    background: Annotated[
        float | None,
        typer.Option(help="counts/s without a scene; from the record unless given"),
    ] = None,
    false_alarms: Annotated[
        float, typer.Option(help="expected false alarms in the whole record, at most")
    ] = 0.01,
    counter_input: Annotated[
        int, typer.Option("--input", min=1, help="input of the counter, 1 for the first")
    ] = 1,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="table of starts, classes and counts of bins, .csv"),
    ] = None,
    trust: options.Trust = False,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Find the transits in a photon file without markers, count their bins, and classify them.

    A transit is a rise of the rate: the photons within the time of all bins exceed a threshold,
    which background alone exceeds as often as --false-alarms says.

    Example: deepfsi camera transits passing.safetensors photons.ptu --bin 100us
    """
    design = paths.check_design(design)
    paths.check_there(file, "a .ptu file")
    if out is not None:
        paths.check_file(out, (".csv",), force)
    from deepfsi.base import write_atomically
    from deepfsi.lab import classify_transits

    made = common.open_any(design, trust)
    with common.progress("transits", quiet=as_json) as report:
        found = classify_transits(
            made,
            file,
            options.seconds("bin", bins),
            photons=photons,
            background=background,
            false_alarms=false_alarms,
            counter_input=counter_input - 1,
            report=report,
        )
    if out is not None:
        write_atomically(out, found.as_csv().encode())
    if as_json:
        common.print_json("camera.transits", found.as_dict())
        return
    rows = [
        [f"{each.start_s:.6g}", f"{sum(each.counts)}", each.predicted, f"{each.confidence:.3f}"]
        for each in found.transits
    ]
    common.print_table("Transits", ["start, s", "photons", "class", "confidence"], rows)
    print(
        f"{len(rows)} transits in {time_text(found.seconds)}: {found.threshold.photons} photons or "
        "more "
        f"within a transit, at a background of {found.background:.4g} counts/s; "
        f"{found.threshold.false_alarms:.2g} false alarms are expected in the record"
    )
    if out is not None:
        print(f"saved: {out}")
