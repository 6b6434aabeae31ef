"""Commands of one design: design, evaluate, stop, show, page."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.base import InputError
from deepfsi.cli import common, options, paths
from deepfsi.cli.results import (
    counts_text,
    details,
    fewest_lit,
    print_full_gates,
    print_guesses,
    print_lit,
    print_tests,
    score,
)
from deepfsi.cli.settings import job_fields, with_settings

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from deepfsi.datasets import Dataset
    from deepfsi.design import Design
    from deepfsi.evaluation import Stopped
    from deepfsi.jobs import Job
    from deepfsi.measures import Result


@with_settings(job_fields)
def design(
    out: options.DesignFile,
    settings: dict[str, Any],
    data: options.Data = "digits",
    size: options.Size = None,
    skip_bad: options.SkipBad = False,
    normal: options.Normal = None,
    hold_out: Annotated[
        int,
        typer.Option(
            help="number of last training scenes to leave out, which `deepfsi stop` needs"
        ),
    ] = 0,
    matrix: options.Matrix = None,
    view: options.View = None,
    device: options.Device = "auto",
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="go on with a training of these settings that was stopped, if there is one: its "
            "state is in a file beside --out, whose name ends in .checkpoint",
        ),
    ] = False,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Learn masks and their classifier, for one photon budget or a range, saved as one file.

    Example: deepfsi design --data mnist --photons 1e4 --masks 10 -o digits.safetensors
    """
    paths.check_file(
        out, paths.DESIGN_ENDINGS, force=True
    )  # one of the same settings may be replaced
    common.check_data(data, view)
    from deepfsi.evaluation import evaluate as test
    from deepfsi.jobs import find_job
    from deepfsi.training import learn

    own = common.read_matrix(matrix)
    counts = settings.pop("counts", None)
    counted = None if counts is None else options.number("counts", counts)
    scenes = common.load(data, options.size_of(size), view, skip_bad=skip_bad, normal=normal)
    asked = options.job_settings(settings, scenes, own)
    job = find_job(asked, counted)
    options.check_sigma(settings, (job.camera.noise_name, job.noise))
    options.check_test(job)
    shown = scenes.hold_out(hold_out) if hold_out else scenes
    if out.exists() and not force:
        _check_same(out, job, shown, own)
    state = _checkpoint(out, resume, force)
    with common.progress(f"{job.design}, {job.masks} masks", as_json) as report:
        asked |= {"counts": counted, "matrix": own, "device": device, "checkpoint": state}
        made = learn(shown, report=report, **asked)
    lowest = made.info["job"]["photons"]
    made.save(out)
    budgets = list(dict.fromkeys((lowest, job.exposure.highest(lowest))))
    with common.progress("test", as_json) as report:
        results = test(made, scenes, budgets, draws=job.draws, report=report)
    notes = [_scenes_text(shown, scenes)]
    if as_json:
        tests = [{"classes": made.classes, **result.as_dict()} for result in results]
        said = {"design": str(out), "info": made.info, "notes": notes, "tests": tests}
        common.print_json("design", {**said, "lit_masks": fewest_lit(results)})
        return
    common.print_data(scenes, notes)
    print(job.exposure.describe(job.optics))
    for result in results:
        print(
            f"{made.name} with {common.size(made)} at {common.budget(result.photons)} photons: "
            f"{score(result)}, {counts_text(result)} (a share of {result.throughput:.3f})\n"
            f"{details(result, made.classes)}"
        )
    print_full_gates(made, results)
    print_lit(results)
    print_guesses(made)
    print(f"saved: {out}")


def _checkpoint(out: Path, resume: bool, force: bool) -> Path:
    """File of a training's state, beside its design; one that is there is for `--resume`."""
    path = out.with_name(f"{out.name}.checkpoint")
    if path.exists() and not resume:
        if not force:
            raise InputError(
                f"{path} is of a training that was stopped: --resume goes on with it, --force "
                "begins anew"
            )
        path.unlink()
    return path


def _scenes_text(trained: "Dataset", tested: "Dataset") -> str:
    """Scenes of a training and its test in words, and what `compare` does otherwise."""
    from deepfsi.sweeps.recipe import Recipe

    count = len(trained.x_train)
    words = (
        f"trained on all {count} scenes, tested on {len(tested.x_test)}; deepfsi compare holds "
        f"{Recipe().held_out(trained)} of them out to choose numbers of masks"
    )
    folds = len(Recipe().parts(tested))
    return words if folds == 1 else f"{words}, and tests every scene once, in {folds} folds"


def evaluate(
    file: Annotated[
        Path, typer.Argument(help="design file, or a folder of patterns that `dmd export` wrote")
    ],
    photons: Annotated[str, typer.Option(help="budgets, such as 1e2,1e3,1e4")],
    data: options.TestData = None,
    size: options.Size = None,
    noise: options.Noise = None,
    sigma: options.Sigma = None,
    dark: options.Dark = None,
    fluctuation: options.LightFluctuation = None,
    first: Annotated[
        int | None, typer.Option(help="use only this many first masks of a nested design")
    ] = None,
    draws: options.Draws = 3,
    ideal: Annotated[
        bool,
        typer.Option("--ideal", help="also give the accuracy of the ideal observer of the counts"),
    ] = False,
    seed: options.NoiseSeed = 0,
    view: options.View = None,
    trust: options.Trust = False,
    device: options.Device = "auto",
    as_json: options.Json = False,
) -> None:
    """Test a design at any budgets, under exact photon noise.

    The test scenes are those of the data that it was trained on, which the design remembers.

    Example: deepfsi evaluate digits.safetensors --photons 1e2,1e3,1e4
    """
    file = paths.check_design(file)
    common.check_data(data, view)
    from deepfsi.evaluation import camera_for, ideal_observer
    from deepfsi.evaluation import evaluate as test
    from deepfsi.lab import data_of
    from deepfsi.physics import torch_device

    budgets = options.numbers("photons", photons) or []
    told: dict[str, Any] = {"noise": noise, "sigma": sigma, "dark": dark}
    told["fluctuation"] = fluctuation
    told = {name: value for name, value in told.items() if value is not None}
    made = common.open_any(file, trust).to(torch_device(device))
    camera = camera_for(made, None, **told)
    options.check_sigma(told, [camera.noise_name])
    if ideal and not camera.noise_facts.exact:
        other = camera.noise_name if camera.noise_facts.steady else "light that fluctuates"
        raise InputError(f"the ideal observer is of photon noise, not {other}: leave --ideal out")
    if ideal:
        made.exposure.check("ideal observer")
    if first is not None:
        made = made.first(first)
    scenes, notes = data_of(made, data, options.size_of(size), view)
    with common.progress("evaluate", quiet=as_json) as report:
        results = test(made, scenes, budgets, camera=camera, draws=draws, seed=seed, report=report)
    bounds: list[Result] = []
    if ideal:
        with common.progress("ideal observer", quiet=as_json) as report:
            bounds = ideal_observer(made, scenes, budgets, draws=draws, seed=seed, report=report)
    if as_json:
        tests, best = (
            [{"classes": made.classes, **result.as_dict()} for result in every]
            for every in (results, bounds)
        )
        optics = {"detectors": made.detection.count, "readout": made.detection.readout}
        said = {"design": str(file), **optics, "notes": notes, "results": tests, "ideal": best}
        common.print_json("evaluate", said)
        return
    common.print_data(scenes, notes)
    print_tests(made, camera.noise_name, results, bounds)
    print_full_gates(made, results)


def stop(
    file: Annotated[
        Path, typer.Argument(help="design file for one device, nested or of several looks")
    ],
    photons: Annotated[str, typer.Option(help="budget of a whole exposure")],
    data: options.TestData = None,
    size: options.Size = None,
    hold_out: Annotated[
        int | None,
        typer.Option(
            help="number of last training scenes that the training left out; that of the design "
            "unless given"
        ),
    ] = None,
    threshold: Annotated[
        float | None,
        typer.Option(help="confidence above which to stop; chosen on left-out scenes unless given"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="write the design with this rule, for `camera live`"),
    ] = None,
    draws: options.Draws = 3,
    seed: options.NoiseSeed = 0,
    trust: options.Trust = False,
    device: options.Device = "auto",
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Stop each exposure once the classifier is confident enough, and say what light this saves.

    Data and left-out scenes are those that the design remembers.

    Example: deepfsi stop nested.safetensors --photons 1e5
    """
    file = paths.check_design(file)
    if out is not None:
        paths.check_file(out, paths.DESIGN_ENDINGS, force)
    common.check_data(data)
    from deepfsi.design import load_design
    from deepfsi.evaluation import stop as run
    from deepfsi.evaluation import with_rule
    from deepfsi.lab import data_of
    from deepfsi.physics import torch_device

    budget = options.number("photons", photons)
    made = load_design(file, torch_device(device), trust=trust)
    if out is not None:
        made.exposure.stopping_at(1.0)
    scenes, notes = data_of(made, data, options.size_of(size))
    with common.progress("stop", quiet=as_json):
        found = run(
            made, scenes, budget, held_out=hold_out, threshold=threshold, draws=draws, seed=seed
        )
    if out is not None:
        with_rule(made, found.rule).save(out)
    if as_json:
        common.print_json("stop", {"design": str(file), "notes": notes, **found.as_dict()})
        return
    common.print_data(scenes, notes)
    _print_stopped(found, common.size(made))
    if out is not None:
        print(f"saved with this rule: {out}")


def _check_same(file: Path, job: "Job", data: "Dataset", matrix: "np.ndarray | None") -> None:
    """Raise `InputError` unless a design file is what training this job would write again."""
    from deepfsi.design import load_design
    from deepfsi.designfile import trained_on

    with suppress(InputError):
        there = load_design(file)
        known = trained_on(there.info)
        of_data = known is not None and known.hash == data.hash
        if of_data and matrix is None and there.info["job"] == job.model_dump(mode="json"):
            return
    raise InputError(
        f"{file} exists already, of other settings: give another name, or --force to replace it"
    )


def _print_stopped(found: "Stopped", size: str) -> None:
    rates = {
        "share of photons used": found.used,
        "accuracy, whole exposures": found.whole,
        "accuracy, stopped": found.stopped,
        "difference, paired": found.difference,
    }
    rows = [
        (head, f"{rate.mean:.4f}", f"[{rate.low:.4f}, {rate.high:.4f}]")
        for head, rate in rates.items()
    ]
    title = (
        f"{size}, {common.budget(found.photons)} photons, stopped above {found.rule.threshold:.5g}"
    )
    common.print_table(title, ("", "mean", "95 % interval"), rows)
    kept = {round(each["accepted"], 2): each["stopped"] for each in found.rejection}
    print(
        f"calibration error of the answers: {found.calibration_error:.4f} "
        f"({found.uncalibrated_error:.4f} without temperatures)\n"
        f"the surest 90 % of the answers: {kept[0.9]:.4f} right; the surest half: {kept[0.5]:.4f}\n"
        f"interval: {found.covers}"
    )


def show(
    file: Annotated[Path, typer.Argument(help="design file")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help="picture: .png, .svg or .pdf; .png beside the design unless given"
        ),
    ] = None,
    count: Annotated[int, typer.Option(help="at most this many masks")] = 24,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Draw the masks of a design, each with its number and its dwell.

    Adaptive masks are drawn for one exposure of a test scene, with what was known after each.

    Example: deepfsi show digits.safetensors -o masks.png
    """
    if out is None:  # beside a file; of a published design's name here
        out = file.with_suffix(".png") if file.exists() else Path(f"{file.name}.png")
    file = paths.check_design(file)
    paths.check_file(out, paths.PICTURES, force)
    from deepfsi.design import load_design
    from deepfsi.designfile import check_masks, trained_on
    from deepfsi.lab import data_of
    from deepfsi.report.masks import masks_figure

    if count < 1:
        raise InputError(f"{count} masks cannot be drawn: give at least 1")
    made = load_design(file)
    check_masks(made.info, "a picture of masks")
    budget = made.info.get("job", {}).get("photons")
    if made.exposure.makes_masks:
        scenes, _ = data_of(made)
        common.draw("show", _exposure(made, scenes, budget), out, as_json)
        return
    exposure = made.mask_exposure
    dwells = exposure.mask_dwells()
    labels = made.detection.labels
    matrix, shape = exposure.drawing()
    figure = masks_figure(
        matrix.cpu().numpy(),
        shape,
        _title(made, count, timed=dwells is not None),
        count,
        dwells=None if dwells is None else dwells.detach().cpu().numpy(),
        parts=None if labels is None else labels.cpu().numpy(),
    )
    common.draw("show", figure, out, as_json)
    if (known := trained_on(made.info)) and not as_json:
        print(f"trained on: {known.words}")


def _title(made: "Design", count: int, timed: bool) -> str:
    """Title of a picture of so many masks of a design, with or without their dwells."""
    from deepfsi.report.masks import lit_masks
    from deepfsi.report.terms import lit_text

    budget = made.info.get("job", {}).get("photons")
    title = f"{made.name}, {common.size(made)}, {made.light}" + (
        f", {common.budget(budget)} photons" if budget else ""
    )
    lit = lit_masks(made.rails.stacked.cpu().numpy())
    if lit < made.masks:
        title += f"\n{lit_text(made.masks, lit)}"
    if count < lit:
        title += f"; the {count} that count most photons"
    if timed:
        title += f"\ndwell: {made.mask_exposure.dwell_words}"
    if made.detection.labels is not None:
        title += "\nlines: parts of the device that one detector sees"
    return title


def _exposure(made: "Design", data: "Dataset", photons: float) -> "Figure":
    """Picture of an exposure of the first test scene."""
    from deepfsi.report.looks import exposure_figure

    scene, true = data.x_test[0], made.classes[data.y_test[0]]
    masks, scenes, chances = made.looks_at(scene, photons)
    answer = made.classes[chances[-1].argmax()]
    title = (
        f"one exposure of {common.budget(photons)} photons in {made.masks} looks. Class: {true}. "
        f"Answer: {answer}, with probability {chances[-1].max():.3f}"
    )
    image = scene.reshape(made.image_shape)
    return exposure_figure(image, masks, scenes, chances, made.classes, title)


def page(
    file: Annotated[
        Path, typer.Argument(help="design file, or a folder of patterns that `dmd export` wrote")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="the page, .html")],
    data: options.TestData = None,
    size: options.Size = None,
    seed: options.NoiseSeed = 0,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Write a page on which anyone can expose a scene to a design and watch it answer.

    One HTML file that needs no server: draw a scene, set the light, start an exposure. Its accuracy
    is measured on the test scenes of the data that the design remembers.

    Example: deepfsi page digits.safetensors -o digits.html
    """
    file = paths.check_design(file)
    paths.check_file(out, (".html",), force)
    common.check_data(data)
    from deepfsi.evaluation import check_playable, playable
    from deepfsi.lab import data_of
    from deepfsi.report.playground.page import write_page

    made = common.open_any(file)
    check_playable(made)
    scenes, notes = data_of(made, data, options.size_of(size))
    with common.progress("page", quiet=as_json) as report:
        payload = playable(made, scenes, seed=seed, report=report)
    write_page(out, payload)
    if as_json:
        measured = {name: payload[name] for name in ("curve", "test", "rules")}
        said = {"design": str(file), "page": str(out), "notes": notes, **measured}
        common.print_json("page", said)
        return
    common.print_data(scenes, notes)
    print(f"page to play with: {out}")
