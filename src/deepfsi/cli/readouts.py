"""Classifier of readouts that were measured, with what its accuracy is worth."""

from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.cli import common, options, paths
from deepfsi.cli.settings import job_fields, with_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deepfsi.training import ReadoutsResult

SETTINGS = ("epochs", "batch", "lr", "hidden", "dropout", "decay")
"""Settings of a job that a training of readouts has."""

NAMES = {
    "random": "a random fifth",
    "later": "the last fifth of each class",
    "pictures": "pictures not seen",
}
"""Splits in words."""


def readouts_fields() -> Any:
    """Options of the training, with the defaults of readouts."""
    from deepfsi.design import TRAINING

    found = {name: (panel, copy(field)) for name, (panel, field) in job_fields().items()}
    for name in TRAINING:
        found[name][1].default = TRAINING[name]
    return {name: found[name] for name in SETTINGS}


@with_settings(readouts_fields)
def readouts(
    source: Annotated[
        Path,
        typer.Argument(
            help="table of readouts, .mat .npz .h5 .csv .parquet; or a folder of such files"
        ),
    ],
    out: options.DesignFile,
    settings: dict[str, Any],
    values: Annotated[
        str | None,
        typer.Option(
            help="variable of the readouts, or pattern of columns such as mode*; the only array, "
            "or all other columns, unless given"
        ),
    ] = None,
    label: Annotated[
        str | None,
        typer.Option(help="variable or column of the class; each file is one unless given"),
    ] = None,
    picture: Annotated[
        str | None, typer.Option(help="variable or column of the picture that was shown")
    ] = None,
    order: Annotated[
        str | None,
        typer.Option(help="variable or column that rises with the time of recording, over all"),
    ] = None,
    monitor: Annotated[
        list[str] | None,
        typer.Option(help="variable or columns of a monitor of the light; may be given again"),
    ] = None,
    split: Annotated[
        str,
        typer.Option(
            help="split whose training part trains the saved design: random, later or pictures"
        ),
    ] = "random",
    figure: Annotated[
        Path | None, typer.Option(help="picture of the accuracies: .png, .svg or .pdf")
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, max=2**32 - 1, help="seed of splits and training")
    ] = 0,
    device: options.Device = "auto",
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Train a classifier on readouts that were measured, masks unknown, and say what it is worth.

    It is tested on a random fifth, on the last fifth of each class, and on pictures not seen; and
    whether the order of recording, or monitors of the light, tell the class alone. Readouts may be
    in any unit and signed. Classify others with `deepfsi camera classify`.

    Example: deepfsi readouts run7/ --values volts --label digit --monitor laser -o run7.safetensors
    """
    paths.check_file(out, paths.DESIGN_ENDINGS, force)
    if figure is not None:
        paths.check_file(figure, paths.PICTURES, force)
    from deepfsi.base import check_choice
    from deepfsi.datasets import Variables, read_readouts
    from deepfsi.training import learn_readouts, measure_readouts

    variables = Variables(values, label, picture, order, tuple(monitor or ()))
    table = read_readouts(source, variables)
    check_choice("split", split, table.splits)
    designs = {}
    with common.progress("readouts", quiet=as_json) as report:
        for name, part in zip(table.splits, report.split(len(table.splits)), strict=True):
            designs[name] = learn_readouts(
                table, name, training=settings, seed=seed, device=device, report=part
            )
            if name == split:
                designs[name].save(out)
    found = measure_readouts(table, designs, seed)
    if figure is not None:
        common.save_figure(_figure(found, source.name), figure)
    if as_json:
        drawn = None if figure is None else str(figure)
        common.print_json("readouts", {"design": str(out), "figure": drawn, **found.as_dict()})
        return
    _print(found, source.name)
    if figure is not None:
        print(f"drawn: {figure}")
    print(f"saved: {out}, trained on what {NAMES[split]} leaves")


def _print(found: "ReadoutsResult", name: str) -> None:
    rows = [
        (
            NAMES[each.split],
            str(each.train),
            str(each.test),
            each.network.text,
            each.ridge.text,
        )
        for each in found.splits
    ]
    rows += [(f"{m.name} alone, a random fifth", "", "", "", m.ridge.text) for m in found.monitors]
    title = f"{name}: {found.recordings} recordings of {found.readouts} readouts, "
    title += f"{len(found.classes)} classes, guessing {found.chance:.3f}"
    heads = ("tested on", "trained", "tested", "network (95 %)", "RBF ridge (95 %)")
    common.print_table(title, heads, rows)
    for line in found.verdict:
        print(line)


def _figure(found: "ReadoutsResult", name: str) -> "Figure":
    from deepfsi.report import ReadoutTest, readouts_figure

    rows = [ReadoutTest(NAMES[each.split], each.network, each.ridge) for each in found.splits]
    rows += [ReadoutTest(f"{each.name} alone", None, each.ridge) for each in found.monitors]
    return readouts_figure(name, rows, found.chance)
