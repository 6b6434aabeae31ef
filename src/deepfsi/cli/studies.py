"""Commands that train many designs: compare, sweep, reproduce, report."""

from itertools import zip_longest
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.base import duration_text
from deepfsi.cli import common, options, paper, paths
from deepfsi.cli.recipes import check_recipe, read_recipe
from deepfsi.cli.settings import job_fields, with_settings

if TYPE_CHECKING:
    import numpy as np

    from deepfsi.datasets import Dataset
    from deepfsi.sweeps.recipe import Recipe
    from deepfsi.sweeps.results import Point, Results


@with_settings(job_fields, axes=True, leave=("design", "seed"))
def compare(
    settings: dict[str, Any],
    out: options.Folder = Path("runs/compare"),
    data: options.Data = "digits",
    size: options.Size = None,
    skip_bad: options.SkipBad = False,
    normal: options.Normal = None,
    designs: options.Designs = None,
    ratios: options.Ratios = None,
    trials: options.Trials = None,
    folds: options.Folds = None,
    matrix: options.Matrix = None,
    recipe: Annotated[
        str | None,
        typer.Option(help="name of a recipe, or TOML file; options given here override it"),
    ] = None,
    device: options.Device = "auto",
    workers: options.Workers = None,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Train every design at every photon budget, and report the accuracy of each.

    Adaptive masks are among the designs where the camera can show them and the data has at most
    5000 scenes. Data with values (an .npz whose y are floats) are reported by R², --normal by the
    area under the ROC curve.

    The mask count of each design is chosen on validation data, and the test set is read once. A
    stopped comparison goes on where it was when run again with the same output folder.

    Without ratios, masks and trials: on digits the ratios 6, 16 and 36 % with three trials of 30
    epochs, on other data the paper's ratios 1, 4, 9, … 100 % with one trial.

    Example: deepfsi compare --data mnist --photons 1e3,1e4 --ratios 0.01,0.04 -o runs/mnist
    """
    paths.check_folder(out)
    common.check_data(data)
    base: dict[str, Any] = {}
    if recipe:
        base = read_recipe(recipe)
    from deepfsi.sweeps.recipe import only
    from deepfsi.sweeps.recipe_check import with_adaptive
    from deepfsi.sweeps.run import check_kept

    own = common.read_matrix(matrix)
    if recipe:
        base = only(base)
    else:
        base = {"data": data}
        if data == "digits" and not (ratios or trials or "masks" in settings):
            base |= QUICK
    unnamed = not (designs or matrix or "designs" in base)
    fields = options.recipe_fields(
        data if data != "digits" else None,
        *(size, skip_bad, normal, designs, ratios, trials, folds),
    )
    chosen = check_recipe(options.recipe_settings(settings, fields, base), own)
    if unnamed:
        chosen = with_adaptive(*chosen), chosen[1]
    options.check_sigma(settings, (*chosen[0].noises, *chosen[0].test_noise))
    if not force:
        check_kept(out, *chosen, own)
    results, _ = _run(chosen, out, "compare", as_json, matrix=own, device=device, workers=workers)
    _finish("compare", results, out, as_json)


def sweep(
    recipe: Annotated[
        str, typer.Argument(help="name of a recipe, such as mnist, or TOML file; lists are axes")
    ],
    part: Annotated[str | None, typer.Option(help="part of a recipe that has several")] = None,
    camera: Annotated[
        str | None, typer.Option(help="a camera in place of the recipe's: a preset, or a TOML file")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="the recipe's coarse version, where it has one")
    ] = False,
    out: options.Folder = Path("runs/sweep"),
    folds: options.Folds = None,
    workers: options.Workers = None,
    ray: options.Ray = None,
    device: options.Device = "auto",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="estimate the time on this machine, and stop")
    ] = False,
    table: Annotated[
        Path | None, typer.Option(help="write all records as one table, .csv or .parquet")
    ] = None,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Run all trials of a recipe, on all cores, a GPU or a Ray cluster.

    It may be stopped at any moment: run again with the same output folder, it goes on where it
    was. After a change of the recipe, trials that are still in it are used; where others would be
    lost, --force is needed. Several processes may work on one folder.

    Example: deepfsi sweep baseline -o runs/baseline --table runs/baseline.csv
    """
    if not dry_run:
        paths.check_folder(out)
    if table is not None:
        paths.check_file(table, paths.TABLES, force, made=out)
    file = read_recipe(recipe)
    from deepfsi.sweeps.recipe import only
    from deepfsi.sweeps.records import write_table
    from deepfsi.sweeps.run import check_kept

    base = only(file, part, quick)
    told = {"camera": camera, "folds": folds}
    told = {name: value for name, value in told.items() if value is not None}
    chosen = check_recipe({**base, **told})
    if dry_run:
        _forecast(chosen, out, device, workers, as_json)
        return
    if not force:
        check_kept(out, *chosen)
    results, records = _run(chosen, out, "sweep", as_json, device=device, workers=workers, ray=ray)
    _finish("sweep", results, out, as_json)
    if table is not None:
        write_table(records, table)
        if not as_json:
            print(f"table: {table}")


def reproduce(
    name: Annotated[
        str,
        typer.Argument(
            help="mnist, compression, mlgauss, quantization, indian-pines, ovit, hardware, "
            "flexible, detectors, adaptive, or list"
        ),
    ],
    out: options.Folder = Path("runs/paper"),
    quick: Annotated[
        bool, typer.Option("--quick", help="a coarse grid, in a fraction of the time")
    ] = False,
    trials: Annotated[
        int | None, typer.Option(min=1, help="training seeds for each point, if not the recipe's")
    ] = None,
    ratios: Annotated[
        str | None,
        typer.Option(help="compression ratios, if not the recipe's: 0.01,0.16,1"),
    ] = None,
    part: Annotated[
        str | None, typer.Option(help="the only part to run, of a recipe with several parts")
    ] = None,
    workers: options.Workers = None,
    ray: options.Ray = None,
    device: options.Device = "auto",
    as_json: options.Json = False,
) -> None:
    """Repeat an experiment of the paper: figures, the numbers behind them, and its claims.

    Experiments in one folder share one page, and the trials that several of them need. A stopped
    experiment goes on when it is run again; with more --trials it adds those that are missing.

    Example: deepfsi reproduce mnist --quick -o runs/paper
    """
    from dataclasses import asdict, replace

    studies = paper.studies()
    if name == "list":
        _list_experiments(studies, as_json)
        return
    changes = {} if ratios is None else {"ratios": options.numbers("ratios", ratios)}
    chosen = [replace(each, changes=changes, part=part) for each in studies.find(name)]
    for each in chosen:
        each.recipes(quick, trials)
    paths.check_folder(out)
    for each in chosen:
        with common.progress(each.name, quiet=as_json) as report:
            each.run(
                out,
                command=common.command_line(),
                quick=quick,
                trials=trials,
                device=device,
                workers=workers,
                ray=ray,
                report=report,
            )
    page = studies.page(out)
    sections = [section for each in chosen if (section := each.section(out))]
    if as_json:
        claims = {
            section.name: [{**asdict(claim), "why": claim.reason} for claim in section.claims]
            for section in sections
        }
        common.print_json("reproduce", {"report": str(page), "claims": claims})
        return
    for section in sections:
        _print_claims(section)
    print(f"report: {page}")


def report(
    folder: Annotated[Path, typer.Argument(help="output of compare, sweep or reproduce")],
    as_json: options.Json = False,
) -> None:
    """Write the report of a comparison, or of all experiments in a folder, again.

    Example: deepfsi report runs/paper
    """
    paths.check_there(folder, "the output of compare, sweep or reproduce")
    from deepfsi.report.comparison_page import build

    is_study = paper.installed() and paper.studies().is_study(folder)
    page = paper.studies().page(folder) if is_study else build(folder)
    if as_json:
        common.print_json("report", {"report": str(page)})
    else:
        print(f"report: {page}")


def _list_experiments(studies: ModuleType, as_json: bool) -> None:
    known = [(study, each) for study, every in studies.STUDIES.items() for each in every]
    if as_json:
        listed = [{"name": s, "part": each.name, "title": each.title} for s, each in known]
        common.print_json("reproduce.list", {"experiments": listed})
        return
    for study, each in known:
        print(f"{study if each is studies.STUDIES[study][0] else '':14s}{each.title}")


def _print_claims(section: Any) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=section.title, title_justify="left", show_lines=True)
    for head in ("claim", "holds", "measured", "why"):
        table.add_column(head)
    answers = {True: "yes", False: "no", None: "open"}
    for claim in section.claims:
        table.add_row(claim.text, answers[claim.holds], claim.measured, claim.reason)
    Console(markup=False, emoji=False).print(table)


def _run(
    chosen: "tuple[Recipe, Dataset]",
    out: Path,
    what: str,
    quiet: bool,
    *,
    matrix: "np.ndarray | None" = None,
    device: str,
    workers: int | None,
    ray: str | None = None,
) -> "tuple[Results, list[dict[str, Any]]]":
    from deepfsi.sweeps.run import compare as run
    from deepfsi.sweeps.workers import Workers

    with common.progress(what, quiet=quiet) as report:
        return run(
            *chosen,
            out,
            command=common.command_line(),
            matrix=matrix,
            device=device,
            workers=Workers(workers, ray),
            report=report,
        )


def _finish(command: str, results: "Results", out: Path, as_json: bool) -> None:
    from deepfsi.report.comparison_page import build, leader_differences, scenes_text
    from deepfsi.report.verdict import verdict_of
    from deepfsi.sweeps.results import write_results

    write_results(out / "results.json", results)
    page = build(out)
    said = verdict_of(results)
    if as_json:
        found = results.as_dict()
        for point in found["points"]:
            point.pop("terms", None)
        told = {
            "notes": [scenes_text(results.data)],
            "differences": list(leader_differences(results)),
        }
        common.print_json(command, {"report": str(page), "verdict": said.text, **found, **told})
        return
    common.print_data(results.data, [scenes_text(results.data)])
    _print_matrix(results)
    print(f"{said.text}\nreport: {page}")


def _forecast(
    chosen: "tuple[Recipe, Dataset]",
    out: Path,
    device: str,
    workers: int | None,
    as_json: bool,
) -> None:
    from dataclasses import asdict

    from deepfsi.sweeps.forecast import forecast_cost

    with common.progress("timing a few steps of each kind", quiet=as_json) as report:
        expected = forecast_cost(*chosen, out, device, workers, report)
    if as_json:
        common.print_json("sweep.forecast", asdict(expected))
        return
    print(
        f"{expected.trials} trials, {expected.done} of them done\n"
        f"batches: {expected.batches}, by {expected.workers} processes\n"
        f"products: {expected.operations:.2g} floating-point operations\n"
        f"expected here: {duration_text(expected.seconds)} beside other programs as now, which "
        f"keep {expected.others:.1f} of {expected.cores} cores busy; "
        f"{duration_text(expected.seconds_free)} without them"
    )


QUICK: dict[str, Any] = {"ratios": (0.06, 0.16, 0.36), "trials": 3, "training": {"epochs": 30}}
"""Recipe of a comparison on digits, where no ratios, masks or trials are given."""


UNEVEN = 0.02
"""Difference of an accuracy from the balanced one, each class counting alike, that is said."""


def _print_matrix(results: "Results") -> None:
    """Print accuracies, a row for each design and a column for each budget."""
    from deepfsi.measures import main_measure
    from deepfsi.report.accuracy import noises
    from deepfsi.report.comparison_page import best_table

    tables = {noise: best_table(results, noise) for noise in noises(results)}
    budgets = sorted({photons for table in tables.values() for photons in table["budgets"]})
    several, rows = len(tables) > 1, []
    for noise, table in tables.items():
        for name, _, cells in table["rows"]:
            at = {
                cell.photons: common.share(cell.accuracy, cell.low, cell.high).replace(" ", "")
                + " *"[cell in table["leaders"][cell.photons]]
                for cell in cells
                if cell
            }
            under = (noise,) if several else ()
            rows.append((name, *under, *(at.get(photons, "– ") for photons in budgets)))
    measure, heads = main_measure(results.data.measure), ("design", *("noise",) * several)
    heads += tuple(common.budget(photons) + " " for photons in budgets)
    common.print_table(f"{measure.title} by photon budget", heads, rows)
    best = [point for point in results.points if point.best]
    for p in best:
        if p.one_class:
            print(f"{p.title} at {common.budget(p.photons)} photons answers one class only")
    aside = ", impulse imaging aside" if any(p.every_pixel for p in best) else ""
    print(
        f"* the highest{aside}, and all that cannot be told apart from it; chance is "
        f"{results.data.chance:.3f}\n± half of the 95 % interval: "
        + "; ".join(dict.fromkeys(p.covers for p in best))
    )
    uneven = max(best, key=_unevenness)
    if _unevenness(uneven) >= UNEVEN:
        worst = common.worst_class(uneven.worst, results.data.classes[uneven.worst_class])
        print(
            f"each class counting alike, {uneven.title} at {common.budget(uneven.photons)} photons "
            f"has a balanced accuracy of {uneven.balanced or 0:.3f}, worst class {worst}; the "
            "report has those of all"
        )
    if results.data.values:
        _value_by_value(results, best)


def _unevenness(point: "Point") -> float:
    """Difference of an accuracy from the balanced one; 0 where there is none, as of values."""
    return 0.0 if point.balanced is None else abs(point.accuracy - point.balanced)


def _value_by_value(results: "Results", best: "list[Point]") -> None:
    """Print the errors of each value, beside those of the best linear estimator."""
    from deepfsi.report.accuracy import key_of, series_axes, series_names

    axes = series_axes(results)
    names = series_names(best, axes)
    rows = [
        (
            *(names[key_of(p, axes)], common.budget(p.photons)),
            *(common.error(e, b) for e, b in zip_longest(p.rmse, p.bound)),
        )
        for p in sorted(best, key=lambda p: (p.photons, -p.accuracy))
    ]
    columns = ("design", "photons", *map(common.short, results.data.values))
    common.print_table("root mean squared error (best linear estimator)", columns, rows)
