"""The command line: parses, calls, prints. Heavy imports happen in the command that needs them."""

import io
import json
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from deepfsi.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from deepfsi.datasets import Dataset
    from deepfsi.recipes import Recipe
    from deepfsi.report.study import Section

app = typer.Typer(
    name="deepfsi",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Design the masks of a photon-limited single-pixel camera with the network that reads "
    "them.\n\nStart with: deepfsi compare",
)
data_app = typer.Typer(
    no_args_is_help=True,
    help="Data sets by name: what there is, fetch it, check it.\n\nExample: deepfsi data list",
)
app.add_typer(data_app, name="data")

DataOption = Annotated[
    str, typer.Option("--data", help="digits, mnist, fashion-mnist, a folder of images or an .npz")
]
SizeOption = Annotated[
    str | None, typer.Option(help="resize folder images to HEIGHTxWIDTH, or one number for both")
]
DeviceOption = Annotated[str, typer.Option(help="auto, cpu or cuda")]
WorkersOption = Annotated[
    int | None, typer.Option(min=1, help="processes; one for each core unless given")
]
RayOption = Annotated[str | None, typer.Option(help="work on a Ray cluster: its address, or auto")]
JsonOption = Annotated[bool, typer.Option("--json", help="print JSON and nothing else")]
LightOption = Annotated[
    str, typer.Option(help="light constraint: column, equal-dwell, free-dwell or two-arm")
]
RailsOption = Annotated[
    str, typer.Option(help="dual: signed masks of two frames each; single: non-negative masks")
]
SigmaOption = Annotated[float, typer.Option(help="gaussian read noise, counts per readout")]
TrainNoiseOption = Annotated[
    str | None,
    typer.Option(help="noise of the training, if another: ml_gauss, poisson, gaussian, none"),
]
MatrixOption = Annotated[
    Path | None, typer.Option(help="your own sensing matrix, .npy of shape (m, N)")
]
EpochsOption = Annotated[int | None, typer.Option(help="training epochs")]


@app.command()
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
    from deepfsi.recipes import Recipe

    if masks is not None and ratios is not None:
        raise InputError("--masks and --ratios are two ways to say one thing: give one, not both")
    own = _matrix(matrix)
    settings = _toml(recipe) if recipe else {}
    if not recipe and data == "digits" and not (ratios or masks or trials):
        settings = dict(_QUICK)
    given = {
        "data": data if recipe is None or _given(context, "data") else None,
        "size": _size(size),
        "designs": _list(designs),
        "photons": _numbers("photons", photons),
        "ratios": _numbers("ratios", ratios),
        "masks": _numbers("masks", masks, whole=True),
        "noise": _list(noise),
        "train_noise": _list(train_noise),
        "sigma": sigma,
        "light": _list(light),
        "rails": _list(rails),
        "trials": trials,
    }
    settings |= {key: value for key, value in given.items() if value is not None}
    if masks is not None:
        settings.pop("ratios", None)
    if ratios is not None:
        settings.pop("masks", None)
    if epochs is not None and isinstance(settings.setdefault("training", {}), dict):
        settings["training"] = {**settings["training"], "epochs": epochs}
    from deepfsi.jobs import reworded

    with reworded():
        chosen = Recipe.model_validate(settings)
        if own is not None and "custom" not in chosen.designs:
            chosen = chosen.model_copy(update={"designs": (*chosen.designs, "custom")})
    _sweep(chosen, out, "compare", matrix=own, device=device, workers=workers, as_json=as_json)


@app.command()
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
    from deepfsi.jobs import reworded
    from deepfsi.recipes import Recipe
    from deepfsi.records import check_table

    if table is not None:
        check_table(table)
    with reworded():
        chosen = Recipe.model_validate(_toml(recipe))
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


@app.command()
def reproduce(
    name: Annotated[str, typer.Argument(help="mnist, compression, mlgauss, quantization, or list")],
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
    _writable(out)
    for each in chosen:
        with _progress(each.name, quiet=as_json) as tell:
            each.run(
                out,
                command=_command(),
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
        _print_json({"report": str(page), "claims": claims})
        return
    for section in sections:
        _print_claims(section)
    print(f"report: {page}")


@app.command()
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
        _print_json(
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
    from deepfsi.records import write_table
    from deepfsi.sweep import compare as run

    scenes = _load(recipe.data, recipe.size)
    for folder in (out, *([table.parent] if table else [])):
        _writable(folder)
    with _progress(what, quiet=as_json) as tell:
        results, records = run(
            recipe,
            scenes,
            out,
            command=_command(),
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
        _print_json(results)
        return
    _print_points(results)
    print(f"report: {page}")
    if table:
        print(f"table: {table}")


def _forecast(recipe: "Recipe", out: Path, device: str, workers: int | None, as_json: bool) -> None:
    from dataclasses import asdict

    from deepfsi.forecast import forecast

    scenes = _load(recipe.data, recipe.size)
    with _progress("timing a few steps of each kind", quiet=as_json):
        expected = forecast(recipe, scenes, out, device, workers)
    if as_json:
        _print_json(asdict(expected))
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


@app.command()
def design(
    photons: Annotated[str, typer.Option(help="budget: expected photons on the coding device")],
    out: Annotated[Path, typer.Option("--out", "-o", help="design file, .safetensors")],
    masks: Annotated[str | None, typer.Option(help="number of masks, m")] = None,
    data: DataOption = "digits",
    size: SizeOption = None,
    name: Annotated[
        str | None, typer.Option("--design", help="which design; deepfsi unless given")
    ] = None,
    noise: Annotated[str, typer.Option(help="poisson, gaussian or none")] = "poisson",
    train_noise: TrainNoiseOption = None,
    sigma: SigmaOption = 1.0,
    light: LightOption = "column",
    rails: RailsOption = "dual",
    epochs: EpochsOption = None,
    seed: Annotated[int, typer.Option(help="repeats exactly on one device")] = 0,
    matrix: MatrixOption = None,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Learn masks and classifier for one budget, and save them as one file.

    Example: deepfsi design --data mnist --photons 1e4 --masks 10 -o digits.safetensors
    """
    from deepfsi import coding
    from deepfsi.evaluation import evaluate as test
    from deepfsi.recipes import TRAINING_NOISE
    from deepfsi.training import learn

    own = _matrix(matrix)
    budget = _one("photons", photons)
    scenes = _load(data, _size(size))
    if noise not in TRAINING_NOISE:
        from deepfsi.errors import closest

        raise InputError(f"unknown noise {noise!r}: {closest(noise, TRAINING_NOISE)}")
    if own is not None and (masks is not None or name not in (None, "custom")):
        raise InputError("--matrix is a design with its own masks: leave --masks and --design out")
    kind = "custom" if own is not None else coding.check_design(name or "deepfsi")
    if own is not None:
        count = len(own)
    elif masks is not None:
        count = _whole("masks", masks)
    elif coding.DESIGNS[kind].fixed_count:
        count = coding.count_allowed(kind, scenes)[1]
    else:
        raise InputError(f"{kind} needs a number of masks: add --masks, for instance --masks 10")
    if out.is_dir():
        raise InputError(f"{out} is a folder: give a file name ending in .safetensors")
    _writable(out.parent)
    settings = {} if epochs is None else {"epochs": epochs}
    with _progress(f"{kind}, {count} masks", quiet=as_json) as tell:
        made = learn(
            scenes,
            photons=budget,
            masks=count,
            design=kind,
            noise=train_noise or TRAINING_NOISE[noise],
            sigma=sigma,
            light=light,
            rails=rails,
            seed=seed,
            matrix=own,
            device=device,
            progress=lambda share: tell(share, ""),
            **settings,
        )
    result = test(made, scenes, budget, noise=noise, sigma=sigma)[0]
    made.save(out)
    if as_json:
        _print_json({"design": str(out), "info": made.info, "test": result.as_dict()})
        return
    print(
        f"{kind} with {made.masks} masks at {budget:g} photons: test accuracy "
        f"{result.accuracy:.4f} [{result.low:.4f}, {result.high:.4f}], "
        f"light throughput {result.throughput:.3f}\nsaved: {out}"
    )


@app.command()
def evaluate(
    file: Annotated[Path, typer.Argument(help="design file")],
    photons: Annotated[str, typer.Option(help="budgets, such as 1e2,1e3,1e4")],
    data: DataOption = "digits",
    size: SizeOption = None,
    noise: Annotated[str, typer.Option(help="poisson, gaussian, ml_gauss or none")] = "poisson",
    sigma: SigmaOption = 1.0,
    draws: Annotated[int, typer.Option(help="noise draws of each scene")] = 3,
    seed: Annotated[int, typer.Option(help="of the noise")] = 0,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Test a design at any budgets, under exact photon noise.

    Example: deepfsi evaluate digits.safetensors --data mnist --photons 1e2,1e3,1e4
    """
    from deepfsi.artifact import Design
    from deepfsi.evaluation import evaluate as test
    from deepfsi.scenes import find_device

    budgets = _numbers("photons", photons) or []
    made = Design.load(file, find_device(device))
    scenes = _load(data, _size(size))
    with _progress("evaluate", quiet=as_json) as tell:
        results = test(
            made,
            scenes,
            budgets,
            noise=noise,
            sigma=sigma,
            draws=draws,
            seed=seed,
            progress=lambda share: tell(share, ""),
        )
    if as_json:
        _print_json({"design": str(file), "results": [result.as_dict() for result in results]})
        return
    rows = [
        (
            f"{r.photons:g}",
            f"{r.accuracy:.4f} [{r.low:.4f}, {r.high:.4f}]",
            _worst(r.rates, made.classes),
            f"{r.throughput:.3f}",
            f"{r.photons * r.throughput / made.masks:.3g}",
        )
        for r in results
    ]
    heads = ("photons", "accuracy, 95 % interval", "worst class", "counted", "counts per mask")
    _print_table(f"{made.name}, {made.masks} masks, {noise} noise", heads, rows)
    print(f"interval: {results[0].covers}")


@app.command()
def show(
    file: Annotated[Path, typer.Argument(help="design file")],
    out: Annotated[Path, typer.Option("--out", "-o", help="picture: .png, .svg or .pdf")],
    count: Annotated[int, typer.Option(help="at most this many masks")] = 24,
) -> None:
    """Draw the masks of a design.

    Example: deepfsi show digits.safetensors -o masks.png
    """
    from deepfsi import report
    from deepfsi.artifact import Design
    from deepfsi.files import write_atomically

    kind = out.suffix.lower()
    if kind not in (".png", ".svg", ".pdf") or out.is_dir():
        raise InputError(f"cannot draw to {out}: end the name in .png, .svg or .pdf")
    if count < 1:
        raise InputError(f"{count} masks cannot be drawn: give at least 1")
    made = Design.load(file)
    _writable(out.parent)
    budget = made.info.get("job", {}).get("photons")
    title = f"{made.name}, {made.masks} masks" + (f", {budget:g} photons" if budget else "")
    figure = report.masks_figure(made.matrix, made.image_shape, title=title, count=count)
    picture = io.BytesIO()
    figure.savefig(picture, dpi=160, format=kind[1:])
    write_atomically(out, picture.getvalue())
    print(f"drawn: {out}")


@data_app.command("list")
def data_list(as_json: JsonOption = False) -> None:
    """List the data sets that have a name, and where they are.

    Example: deepfsi data list --json
    """
    from deepfsi.datasets import list_datasets

    known = list_datasets()
    if as_json:
        _print_json([entry._asdict() for entry in known])
        return
    rows = [
        (entry.name, str(entry.images), str(entry.pixels), str(entry.classes), str(entry.where))
        for entry in known
    ]
    _print_table("data sets", ("name", "images", "pixels", "classes", "where"), rows)


@data_app.command("download")
def data_download(name: Annotated[str, typer.Argument(help="name of a data set")]) -> None:
    """Fetch a data set once, checked by hash.

    Example: deepfsi data download mnist
    """
    from deepfsi.datasets import download

    print(f"{name}: {download(name)}")


@data_app.command("check")
def data_check(
    name: Annotated[str, typer.Argument(help="name of a data set")], as_json: JsonOption = False
) -> None:
    """Compare a data set's files with their known hashes.

    Example: deepfsi data check mnist
    """
    from deepfsi.datasets import check

    files = check(name)
    if as_json:
        _print_json([entry._asdict() for entry in files])
    else:
        rows = [(str(f.file), "good" if f.ok else "BAD", f.detail) for f in files]
        _print_table(name, ("file", "state", "detail"), rows)
    if not all(entry.ok for entry in files):
        raise typer.Exit(1)


def main() -> NoReturn:
    """Entry point: 0 done, 1 a check failed, 2 bad input, 130 stopped by Ctrl-C."""
    try:
        code = app(standalone_mode=False)
    except typer.Exit as stop:
        code = stop.exit_code
    except (KeyboardInterrupt, typer.Abort):
        code = _STOPPED
    except InputError as error:
        _fail(str(error))
    except typer.TyperException as error:
        _fail(getattr(error, "format_message", error.__str__)())
    except OSError as error:
        _fail(f"{error.filename or 'cannot write the output'}: {error.strerror or error}")
    if code == _STOPPED:
        resumes = sys.argv[1:2] in (["compare"], ["sweep"], ["reproduce"])
        kept = "; finished trials are kept, run again to go on" if resumes else ""
        print(f"deepfsi: stopped{kept}", file=sys.stderr)
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str) -> NoReturn:
    print(f"deepfsi: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)


_STOPPED = 130
_QUICK: dict[str, Any] = {
    "ratios": (0.06, 0.16, 0.36),
    "trials": 3,
    "training": {"epochs": 30},
}


def _given(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _worst(rates: Sequence[float | None], classes: Sequence[str]) -> str:
    rate, name = min(
        (rate, name) for rate, name in zip(rates, classes, strict=True) if rate is not None
    )
    return f"{rate:.3f} ({name})"


def _list(text: str | None) -> list[str] | None:
    return None if text is None else [part.strip() for part in text.split(",") if part.strip()]


def _numbers(option: str, text: str | None, whole: bool = False) -> list[Any] | None:
    parts = _list(text)
    if parts is None:
        return None
    if not parts:
        raise InputError(f"--{option} is empty: give one number or more, separated by commas")
    return [_whole(option, part) if whole else _one(option, part) for part in parts]


def _one(option: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--{option} {text!r} is not a number") from None


def _whole(option: str, text: str) -> int:
    value = _one(option, text)
    if not value.is_integer():
        raise InputError(f"--{option} {text!r} is not a whole number")
    return int(value)


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    sides = text.lower().split("x")
    if not all(side.isdecimal() and int(side) > 0 for side in sides) or len(sides) > 2:
        raise InputError(f"--size {text!r} is not allowed: give HEIGHTxWIDTH, such as 32x32")
    return int(sides[0]), int(sides[-1])


def _load(data: str, size: tuple[int, int] | None) -> "Dataset":
    from deepfsi.datasets import load_dataset

    return load_dataset(data, size=size)


def _matrix(path: Path | None) -> "np.ndarray | None":
    if path is None:
        return None
    import numpy as np

    try:
        matrix = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        raise InputError(f"no matrix in {path}: give an .npy file of shape (m, N)") from None
    if not isinstance(matrix, np.ndarray) or matrix.ndim != 2 or not matrix.size:
        raise InputError(f"{path} does not hold one matrix of shape (m, N)")
    return matrix


def _toml(path: Path) -> dict[str, Any]:
    import tomllib

    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"no recipe at {path}: give a TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not TOML: {error}") from None


def _writable(folder: Path) -> None:
    """Fail before the work rather than after it, and leave nothing behind."""
    import tempfile

    there = folder
    while not there.exists():
        there = there.parent
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise InputError(
            f"cannot write to {folder}: {error.strerror}; choose another place with -o"
        ) from None


def _command() -> str:
    return shlex.join(["deepfsi", *sys.argv[1:]])


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=1))


def _print_table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for number, head in enumerate(heads):
        table.add_column(head, justify="left" if number == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


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
    _print_table(results["title"], heads, rows)
    print("interval: " + "; ".join(dict.fromkeys(p["covers"] for p in best)))
    print("counted: share of the budget that reaches a detector")
    if results["chosen_on"] == "validation":
        print("mask counts were chosen on validation data; the table is of test data")


@contextmanager
def _progress(what: str, quiet: bool) -> Iterator[Callable[[float, str], None]]:
    """Progress bar on standard error with the time left."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as TimeLeft

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeLeft())
    console = Console(stderr=True)
    hidden = quiet or not console.is_terminal
    with Progress(*columns, console=console, disable=hidden, transient=True) as bar:
        task = bar.add_task(what, total=1.0)

        def tell(share: float, now: str) -> None:
            bar.update(task, completed=share, description=now or what)

        yield tell
