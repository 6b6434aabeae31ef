"""Commands of one design: design, evaluate, stop, show."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.cli.common import (
    DataOption,
    DeviceOption,
    EpochsOption,
    JsonOption,
    LightOption,
    MatrixOption,
    RailsOption,
    SigmaOption,
    SizeOption,
    TrainNoiseOption,
    ViewOption,
    check_picture,
    check_writable,
    draw,
    load,
    numbers,
    one,
    open_design,
    print_json,
    print_table,
    progress,
    read_matrix,
    size_of,
    whole_number,
)
from deepfsi.errors import InputError

if TYPE_CHECKING:
    from deepfsi.design.artifact import Design
    from deepfsi.design.stopping import Stopped


def design(
    photons: Annotated[
        str,
        typer.Option(
            help="budget: expected photons on the coding device; LOW:HIGH for a range of budgets"
        ),
    ],
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
    nested: Annotated[
        int, typer.Option(help="fewest masks, first ones, that must do by themselves; 0: all")
    ] = 0,
    levels: Annotated[
        int, typer.Option(help="grey levels of a cell, dark included, that masks are made of")
    ] = 0,
    looks: Annotated[
        int,
        typer.Option(help="looks of an exposure: counts of each choose the dwells of the next"),
    ] = 1,
    epochs: EpochsOption = None,
    hold_out: Annotated[
        int, typer.Option(help="last training scenes to leave out, for `deepfsi stop`")
    ] = 0,
    seed: Annotated[int, typer.Option(help="repeats exactly on one device")] = 0,
    matrix: MatrixOption = None,
    view: ViewOption = None,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Learn masks and classifier for one budget or a range of them, and save them as one file.

    Example: deepfsi design --data mnist --photons 1e4 --masks 10 -o digits.safetensors
    """
    from deepfsi.design.evaluation import evaluate as test
    from deepfsi.optics import codes
    from deepfsi.sweeps.recipe import TRAINING_NOISE
    from deepfsi.training.learning import learn

    own = read_matrix(matrix)
    budgets = budget_range(photons)
    scenes = load(data, size_of(size), view)
    if noise not in TRAINING_NOISE:
        from deepfsi.errors import closest

        raise InputError(f"unknown noise {noise!r}: {closest(noise, TRAINING_NOISE)}")
    if own is not None and (masks is not None or name not in (None, "custom")):
        raise InputError("--matrix is a design with its own masks: leave --masks and --design out")
    kind = "custom" if own is not None else codes.check_design(name or "deepfsi")
    if own is not None:
        count = len(own)
    elif masks is not None:
        count = whole_number("masks", masks)
    elif codes.DESIGNS[kind].fixed_count:
        count = codes.count_allowed(kind, scenes)[1]
    else:
        raise InputError(f"{kind} needs a number of masks: add --masks, for instance --masks 10")
    if out.is_dir():
        raise InputError(f"{out} is a folder: give a file name ending in .safetensors")
    check_writable(out.parent)
    seen = scenes.hold_out(hold_out) if hold_out else scenes
    settings: dict[str, Any] = {
        "levels": levels,
        "nested": nested,
        "looks": looks,
        "span": budgets[1] / budgets[0],
    }
    if epochs is not None:
        settings["epochs"] = epochs
    usual = TRAINING_NOISE[noise]
    if looks > 1 and usual == "ml_gauss":
        usual = "poisson"  # a look shows many masks too shortly for MLGauss
    with progress(f"{kind}, {count} masks", quiet=as_json) as tell:
        made = learn(
            seen,
            photons=budgets[0],
            masks=count,
            design=kind,
            noise=train_noise or usual,
            sigma=sigma,
            light=light,
            rails=rails,
            seed=seed,
            matrix=own,
            device=device,
            progress=lambda share: tell(share, ""),
            **settings,
        )
    results = test(made, scenes, list(dict.fromkeys(budgets)), noise=noise, sigma=sigma)
    made.save(out)
    if as_json:
        tests = [result.as_dict() for result in results]
        print_json({"design": str(out), "info": made.info, "test": tests[0], "tests": tests})
        return
    for result in results:
        print(
            f"{kind} with {made.masks} masks at {result.photons:g} photons: test accuracy "
            f"{result.accuracy:.4f} [{result.low:.4f}, {result.high:.4f}], "
            f"light throughput {result.throughput:.3f}"
        )
    print(f"saved: {out}")


def budget_range(text: str) -> tuple[float, float]:
    """Lowest and highest budget of NUMBER or LOW:HIGH; `InputError` names the option."""
    parts = [one("photons", part) for part in text.split(":")]
    if len(parts) > 2 or not 0 < parts[0] <= parts[-1]:
        raise InputError(
            f"--photons {text!r} is not allowed: give a number above 0, or LOW:HIGH such as 1e3:1e6"
        )
    return parts[0], parts[-1]


def evaluate(
    file: Annotated[
        Path, typer.Argument(help="design file, or a folder of patterns that `dmd export` wrote")
    ],
    photons: Annotated[str, typer.Option(help="budgets, such as 1e2,1e3,1e4")],
    data: DataOption = "digits",
    size: SizeOption = None,
    noise: Annotated[str, typer.Option(help="poisson, gaussian, ml_gauss or none")] = "poisson",
    sigma: SigmaOption = 1.0,
    first: Annotated[
        int | None, typer.Option(help="show only so many masks of a nested design, the first ones")
    ] = None,
    draws: Annotated[int, typer.Option(help="noise draws of each scene")] = 3,
    seed: Annotated[int, typer.Option(help="of the noise")] = 0,
    view: ViewOption = None,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Test a design at any budgets, under exact photon noise.

    Example: deepfsi evaluate digits.safetensors --data mnist --photons 1e2,1e3,1e4
    """
    from deepfsi.design.evaluation import evaluate as test
    from deepfsi.training.training_set import find_device

    budgets = numbers("photons", photons) or []
    made = open_design(file).to(find_device(device))
    if first is not None:
        made = made.first(first)
    scenes = load(data, size_of(size), view)
    with progress("evaluate", quiet=as_json) as tell:
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
        print_json({"design": str(file), "results": [result.as_dict() for result in results]})
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
    print_table(f"{made.name}, {_size(made)}, {noise} noise", heads, rows)
    print(f"interval: {results[0].covers}")


def stop(
    file: Annotated[
        Path, typer.Argument(help="design file for one device, nested or of several looks")
    ],
    photons: Annotated[str, typer.Option(help="budget of a whole exposure")],
    data: DataOption = "digits",
    size: SizeOption = None,
    hold_out: Annotated[
        int | None,
        typer.Option(help="last training scenes that the training left out; a sixth unless given"),
    ] = None,
    threshold: Annotated[
        float | None, typer.Option(help="confidence above which to stop; chosen unless given")
    ] = None,
    draws: Annotated[int, typer.Option(help="noise draws of each scene")] = 3,
    seed: Annotated[int, typer.Option(help="of the noise")] = 0,
    device: DeviceOption = "auto",
    as_json: JsonOption = False,
) -> None:
    """Stop exposures as soon as their answer is sure enough, and say what that saves.

    Example: deepfsi stop nested.safetensors --data mnist --photons 1e5 --hold-out 10000
    """
    from deepfsi.design.artifact import Design
    from deepfsi.design.stopping import stop as run
    from deepfsi.training.training_set import find_device

    budget = one("photons", photons)
    made = Design.load(file, find_device(device))
    scenes = load(data, size_of(size))
    with progress("stop", quiet=as_json):
        found = run(
            made, scenes, budget, held_out=hold_out, threshold=threshold, draws=draws, seed=seed
        )
    if as_json:
        print_json({"design": str(file), **found.as_dict()})
        return
    _print_stopped(found, _size(made))


def _size(made: "Design") -> str:
    looks = f" and {made.schedule.looks} looks" if made.schedule is not None else ""
    return f"{made.masks} masks{looks}"


def _print_stopped(found: "Stopped", size: str) -> None:
    rows = []
    for heading, rate in (
        ("share of photons used", found.used),
        ("accuracy, whole exposures", found.whole),
        ("accuracy, stopped", found.stopped),
        ("difference, paired", found.difference),
    ):
        rows.append((heading, f"{rate.mean:.4f}", f"[{rate.low:.4f}, {rate.high:.4f}]"))
    title = f"{size}, {found.photons:g} photons, stopped above {found.rule.threshold:.5g}"
    print_table(title, ("", "mean", "95 % interval"), rows)
    kept = {round(each["accepted"], 2): each["stopped"] for each in found.rejection}
    print(
        f"calibration error of the answers: {found.calibration_error:.4f} "
        f"({found.uncalibrated_error:.4f} without temperatures)\n"
        f"the surest 90 % of the answers: {kept[0.9]:.4f} right; the surest half: {kept[0.5]:.4f}\n"
        f"interval: {found.covers}"
    )


def show(
    file: Annotated[Path, typer.Argument(help="design file")],
    out: Annotated[Path, typer.Option("--out", "-o", help="picture: .png, .svg or .pdf")],
    count: Annotated[int, typer.Option(help="at most this many masks")] = 24,
) -> None:
    """Draw the masks of a design.

    Example: deepfsi show digits.safetensors -o masks.png
    """
    from deepfsi import report
    from deepfsi.design.artifact import Design

    check_picture(out)
    if count < 1:
        raise InputError(f"{count} masks cannot be drawn: give at least 1")
    made = Design.load(file)
    check_writable(out.parent)
    budget = made.info.get("job", {}).get("photons")
    title = f"{made.name}, {made.masks} masks" + (f", {budget:g} photons" if budget else "")
    figure = report.masks_figure(made.matrix, made.image_shape, title=title, count=count)
    draw(figure, out)


def _worst(rates: Sequence[float | None], classes: Sequence[str]) -> str:
    rate, name = min(
        (rate, name) for rate, name in zip(rates, classes, strict=True) if rate is not None
    )
    return f"{rate:.3f} ({name})"
