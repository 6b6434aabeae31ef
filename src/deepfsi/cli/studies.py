"""Commands that train many designs: compare, sweep, reproduce, report."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.cli.common import (
    DataOption,
    DeviceOption,
    EpochsOption,
    JsonOption,
    MatrixOption,
    RayOption,
    SizeOption,
    TrainNoiseOption,
    WorkersOption,
    check_writable,
    command_line,
    load,
    numbers,
    print_json,
    print_table,
    progress,
    read_matrix,
    read_toml,
    size_of,
    words,
)
from deepfsi.errors import InputError, as_input_error

if TYPE_CHECKING:
    import numpy as np

    from deepfsi.report.study_page import Section
    from deepfsi.sweeps.recipe import Recipe


def compare(
    context: typer.Context,
    out: Annotated[Path, typer.Option("--out", "-o", help="output folder")] = Path("runs/compare"),
    data: DataOption = "digits",
    size: SizeOption = None,
    designs: Annotated[str | None, typer.Option(help="names, separated by commas")] = None,
    photons: Annotated[str | None, typer.Option(help="budgets, such as 1e3,1e4,1e5")] = None,
    ratios: Annotated[
        str | None, typer.Option(help="compression ratios m/N, such as 0.01,0.04,0.09")
    ] = None,
    masks: Annotated[str | None, typer.Option(help="mask counts, instead of ratios")] = None,
    noise: Annotated[str | None, typer.Option(help="poisson, gaussian, none")] = None,
    train_noise: TrainNoiseOption = None,
    sigma: Annotated[float | None, typer.Option(help="gaussian noise, counts per readout")] = None,
    light: Annotated[str | None, typer.Option(help="light constraints")] = None,
    rails: Annotated[str | None, typer.Option(help="dual, single")] = None,
    trials: Annotated[int | None, typer.Option(help="training seeds for each point")] = None,
    epochs: EpochsOption = None,
    matrix: MatrixOption = None,
    recipe: Annotated[
        Path | None, typer.Option(help="TOML file; options given here override it")
    ] = None,
    device: DeviceOption = "auto",
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Train every design at every budget, and report which sees best.

    The mask count of each design is chosen on validation data, and the test set is read once. A
    stopped comparison goes on where it was when run again with the same output folder.

    Without ratios, masks and trials: on digits the ratios 6, 16 and 36 % with three trials of 30
    epochs, on other data the paper's ratios 1, 4, 9, … 100 % with one trial.

    Example: deepfsi compare --data mnist --photons 1e3,1e4 --ratios 0.01,0.04 -o runs/mnist
    """
    from deepfsi.sweeps.recipe import Recipe

    if masks is not None and ratios is not None:
        raise InputError("--masks and --ratios are two ways to say one thing: give one, not both")
    own = read_matrix(matrix)
    settings = read_toml(recipe) if recipe else {}
    if not recipe and data == "digits" and not (ratios or masks or trials):
        settings = dict(_QUICK)
    given = {
        "data": data if recipe is None or _given(context, "data") else None,
        "size": size_of(size),
        "designs": words(designs),
        "photons": numbers("photons", photons),
        "ratios": numbers("ratios", ratios),
        "masks": numbers("masks", masks, whole=True),
        "noise": words(noise),
        "train_noise": words(train_noise),
        "sigma": sigma,
        "light": words(light),
        "rails": words(rails),
        "trials": trials,
    }
    settings |= {key: value for key, value in given.items() if value is not None}
    if masks is not None:
        settings.pop("ratios", None)
    if ratios is not None:
        settings.pop("masks", None)
    if epochs is not None and isinstance(settings.setdefault("training", {}), dict):
        settings["training"] = {**settings["training"], "epochs": epochs}

    with as_input_error():
        chosen = Recipe.model_validate(settings)
        if own is not None and "custom" not in chosen.designs:
            chosen = chosen.model_copy(update={"designs": (*chosen.designs, "custom")})
    _sweep(chosen, out, "compare", matrix=own, device=device, workers=workers, as_json=as_json)


def sweep(
    recipe: Annotated[Path, typer.Argument(help="TOML file: every list in it is an axis")],
    out: Annotated[Path, typer.Option("--out", "-o", help="output folder")] = Path("runs/sweep"),
    workers: WorkersOption = None,
    ray: RayOption = None,
    device: DeviceOption = "auto",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="say what it would cost here, and do nothing")
    ] = False,
    table: Annotated[
        Path | None, typer.Option(help="write all records as one table, .csv or .parquet")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run all trials of a recipe, on all cores, a GPU or a Ray cluster.

    It may be stopped at any moment: run again with the same output folder it goes on where it was,
    also after a change of the recipe. Several may work on one folder.

    Example: deepfsi sweep recipes/baseline.toml -o runs/baseline --table runs/baseline.csv
    """
    from deepfsi.sweeps.recipe import Recipe
    from deepfsi.sweeps.records import check_table

    if table is not None:
        check_table(table)
    with as_input_error():
        chosen = Recipe.model_validate(read_toml(recipe))
    if dry_run:
        _forecast(chosen, out, device, workers, as_json)
        return
    _sweep(
        chosen,
        out,
        "sweep",
        device=device,
        workers=workers,
        ray=ray,
        table=table,
        as_json=as_json,
    )


def reproduce(
    name: Annotated[
        str,
        typer.Argument(
            help="mnist, compression, mlgauss, quantization, indian-pines, ovit, hardware, "
            "forgiving, or list"
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="output folder")] = Path("runs/paper"),
    quick: Annotated[
        bool, typer.Option("--quick", help="a coarse grid: minutes instead of hours")
    ] = False,
    trials: Annotated[
        int | None, typer.Option(min=1, help="training seeds for each point, if not the recipe's")
    ] = None,
    workers: WorkersOption = None,
    ray: RayOption = None,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Repeat an experiment of the paper: figures, the numbers behind them, and its claims.

    Experiments in one folder share what they train and one page. Stopped, they go on when run
    again; with more --trials they add what is missing.

    Example: deepfsi reproduce mnist --quick -o runs/paper
    """
    from dataclasses import asdict

    from deepfsi import experiments

    if name == "list":
        _list_experiments(as_json)
        return
    chosen = experiments.find(name)
    check_writable(out)
    for each in chosen:
        with progress(each.name, quiet=as_json) as tell:
            each.run(
                out,
                command=command_line(),
                quick=quick,
                trials=trials,
                device=device,
                workers=workers,
                ray=ray,
                report=tell,
            )
    page = experiments.page(out)
    sections = [section for each in chosen if (section := each.section(out))]
    if as_json:
        claims = {section.name: [asdict(claim) for claim in section.claims] for section in sections}
        print_json({"report": str(page), "claims": claims})
        return
    for section in sections:
        _print_claims(section)
    print(f"report: {page}")


def report(
    folder: Annotated[Path, typer.Argument(help="output of compare, sweep or reproduce")],
) -> None:
    """Write the page of a comparison, or of all experiments in a folder, anew.

    Example: deepfsi report runs/paper
    """
    from deepfsi import experiments
    from deepfsi.report import build

    write = experiments.page if experiments.is_study(folder) else build
    print(f"report: {write(folder)}")


def _list_experiments(as_json: bool) -> None:
    from deepfsi import experiments

    if as_json:
        print_json(
            [
                {"name": study, "part": each.name, "title": each.title}
                for study, members in experiments.STUDIES.items()
                for each in members
            ]
        )
        return
    for study, members in experiments.STUDIES.items():
        for each in members:
            print(f"{study if each is members[0] else '':14s}{each.title}")


def _print_claims(section: "Section") -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=section.title, title_justify="left", show_lines=True)
    for head in ("claim of the paper", "holds", "measured", "why"):
        table.add_column(head)
    answers = {True: "yes", False: "no", None: "open"}
    for claim in section.claims:
        table.add_row(claim.text, answers[claim.holds], claim.measured, claim.why)
    Console().print(table)


def _sweep(
    recipe: "Recipe",
    out: Path,
    what: str,
    *,
    matrix: "np.ndarray | None" = None,
    device: str,
    workers: int | None,
    ray: str | None = None,
    table: Path | None = None,
    as_json: bool,
) -> None:
    from deepfsi import report
    from deepfsi.files import write_atomically
    from deepfsi.sweeps.records import write_table
    from deepfsi.sweeps.run import compare as run

    scenes = load(recipe.data, recipe.size, split=recipe.split)
    for folder in (out, *([table.parent] if table else [])):
        check_writable(folder)
    with progress(what, quiet=as_json) as tell:
        results, records = run(
            recipe,
            scenes,
            out,
            command=command_line(),
            matrix=matrix,
            device=device,
            workers=workers,
            ray=ray,
            report=tell,
        )
    write_atomically(out / "results.json", json.dumps(results, indent=1).encode())
    page = report.build(out)
    if table:
        write_table(records, table)
    if as_json:
        print_json(results)
        return
    _print_points(results)
    print(f"report: {page}")
    if table:
        print(f"table: {table}")


def _forecast(recipe: "Recipe", out: Path, device: str, workers: int | None, as_json: bool) -> None:
    from dataclasses import asdict

    from deepfsi.sweeps.forecast import forecast

    scenes = load(recipe.data, recipe.size, split=recipe.split)
    with progress("timing a few steps of each kind", quiet=as_json):
        expected = forecast(recipe, scenes, out, device, workers)
    if as_json:
        print_json(asdict(expected))
        return
    print(
        f"{expected.trials} trials, {expected.done} of them done\n"
        f"batches: {expected.batches}, by {expected.workers} processes\n"
        f"products: {expected.operations:.2g} floating-point operations\n"
        f"expected here: {_duration(expected.seconds)}"
    )


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


_QUICK: dict[str, Any] = {
    "ratios": (0.06, 0.16, 0.36),
    "trials": 3,
    "training": {"epochs": 30},
}


def _given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _print_points(results: dict[str, Any]) -> None:
    from deepfsi.report.figures import axis_text, series_axes

    best = [point for point in results["points"] if point["best"]]
    apart = [axis for axis in series_axes(results) if axis not in ("design", "masks")]
    axes = ["noise", *apart]
    axes = [axis for axis in axes if len({str(point.get(axis)) for point in best}) > 1]
    names = (axis.replace("_", " ") for axis in axes)
    heads = ("design", *names, "photons", "masks", "accuracy, 95 % interval", "counted")
    best.sort(key=lambda p: (*(str(p[axis]) for axis in axes), p["photons"], -p["accuracy"]))
    rows = [
        (
            f"{p['title']} ({p['label']})",
            *(axis_text(axis, p[axis]) for axis in axes),
            f"{p['photons']:g}",
            str(p["masks"]),
            f"{p['accuracy']:.4f} [{p['low']:.4f}, {p['high']:.4f}]",
            f"{p['throughput']:.3f}",
        )
        for p in best
    ]
    print_table(results["title"], heads, rows)
    print("interval: " + "; ".join(dict.fromkeys(p["covers"] for p in best)))
    print("counted: share of the budget that reaches a detector")
    if results["chosen_on"] == "validation":
        print("mask counts were chosen on validation data; the table is of test data")
