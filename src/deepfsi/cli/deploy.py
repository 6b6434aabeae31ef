"""Commands on the way to a camera: what it needs (plan), and the classifier for it (export)."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from deepfsi.cli import common, options, paths
from deepfsi.cli.recipes import check_recipe
from deepfsi.cli.settings import job_fields, with_settings


def export(
    file: Annotated[
        Path, typer.Argument(help="design file, or a folder of patterns that `dmd export` wrote")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="the design's name with .onnx unless given")
    ] = None,
    trust: options.Trust = False,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Write the classifier of a design as an ONNX graph, which runs without this package.

    Counts and budget in, class probabilities out; all scaling is inside. `dmd export` writes the
    masks.

    Example: deepfsi export digits.safetensors -o digits.onnx
    """
    target, file = out or file.with_suffix(".onnx"), paths.check_design(file)
    paths.check_file(target, (".onnx",), force)
    from deepfsi.base import write_atomically
    from deepfsi.design import to_onnx

    design = common.open_design(file, trust)
    write_atomically(target, to_onnx(design))
    if as_json:
        sizes = {
            "rails": design.rails.count,
            "masks": design.masks,
            "detectors": design.detection.count,
            "classes": design.classes,
            "looks": design.exposure.looks,
        }
        common.print_json("export", {"graph": str(target), **sizes})
        return
    shape = ", ".join(map(str, ("batch", *design.counts_shape)))
    looks = ", dwell, left, shortest" if design.exposure.chooses else ""
    print(
        f"in: counts ({shape}), photons (batch,){looks}\n"
        f"out: probabilities (batch, {len(design.classes)}){', next' if looks else ''}\n"
        f"saved: {target}"
    )


@with_settings(job_fields, axes=True, leave=("design", "seed"))
def plan(
    target: Annotated[str, typer.Option(help="target accuracy, such as 0.95")],
    settings: dict[str, Any],
    out: options.Folder = Path("runs/plan"),
    data: options.Data = "digits",
    size: options.Size = None,
    skip_bad: options.SkipBad = False,
    designs: options.Designs = None,
    ratios: options.Ratios = None,
    trials: options.Trials = None,
    device: options.Device = "auto",
    workers: options.Workers = None,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Find how many photons, masks and detectors each design needs for a target accuracy.

    Every design is trained at a few budgets, then near the budget at which its accuracy meets the
    target. Accuracies in between are interpolated; the interval covers any shape that the curve may
    plausibly have there.

    A stopped plan goes on when it is run again with the same output folder, also with another
    target.

    Example: deepfsi plan --data mnist --target 0.9 --designs pca,deepfsi -o runs/plan
    """
    paths.check_folder(out)
    common.check_data(data)
    from deepfsi.base import write_atomically
    from deepfsi.sweeps.planning import check_plan, photons_needed
    from deepfsi.sweeps.results import write_results
    from deepfsi.sweeps.run import check_kept
    from deepfsi.sweeps.workers import Workers

    accuracy = options.number("target", target)
    fields = options.recipe_fields(data, size, skip_bad, None, designs, ratios, trials)
    recipe, scenes = check_recipe(options.recipe_settings(settings, fields, PLANNED))
    options.check_sigma(settings, recipe.noises)
    check_plan(recipe, scenes, accuracy)
    if not force:
        check_kept(out, recipe, scenes)
    with common.progress("plan", quiet=as_json) as report:
        found, results = photons_needed(
            recipe,
            scenes,
            accuracy,
            out,
            command=common.command_line(),
            device=device,
            workers=Workers(workers),
            report=report,
        )
    write_atomically(out / "plan.json", json.dumps(found, indent=1).encode())
    write_results(out / "results.json", results)
    if as_json:
        common.print_json("plan", found)
        return
    common.print_data(scenes)
    axes = ("light", "rails", "detectors", "readout")
    several = [axis for axis in axes if len({need[axis] for need in found["needs"]}) > 1]
    _print_needs(found, several)
    print(f"plan: {out / 'plan.json'}")


PLANNED: dict[str, Any] = {
    "designs": ("impulse", "raster", "truncated-hadamard", "pca", "deepfsi"),
    "photons": (1e2, 1e3, 1e4, 1e5, 1e6),
    "ratios": (0.01, 0.04, 0.16),
    "trials": 2,
}
"""Recipe of a plan where nothing else is given; budgets are added where the target is met."""


def _print_needs(plan: Mapping[str, Any], axes: list[str]) -> None:
    from deepfsi.jobs import DESIGNS

    def two_digits(photons: float) -> str:
        return common.budget(float(f"{photons:.1e}"))

    def photons(need: Mapping[str, Any]) -> str:
        tried = need["tried"]
        if need["found"] == "below":
            return f"{common.budget(tried[0]['photons'])} or fewer"
        above = f"above {common.budget(tried[-1]['photons'])}"
        return two_digits(need["photons"]) if need["photons"] else above

    def interval(need: Mapping[str, Any]) -> str:
        low, high = (end and two_digits(end) for end in (need["low"], need["high"]))
        if low is None:
            return "any" if high is None else f"{high} or fewer"
        return f"{low} or more" if high is None else f"{low} to {high}"

    def axis_text(need: Mapping[str, Any], axis: str) -> str:
        if axis == "detectors":
            return common.detectors_text(need["design"], need[axis])
        return need[axis] or "–"

    needs = sorted(plan["needs"], key=lambda need: need["photons"] or float("inf"))
    rows = [
        (
            DESIGNS[need["design"]].title,
            photons(need),
            interval(need),
            str(need["masks"]),
            str(len(need["tried"])),
            *(axis_text(need, axis) for axis in axes),
        )
        for need in needs
    ]
    heads = ("design", "photons", "95 % interval", "masks", "tried", *axes)
    common.print_table(f"{plan['data']['name']}: accuracy {plan['target']:g} needs", heads, rows)
    print(f"interval: {plan['covers']}; tried: budgets of its curve")
    print(
        "mask counts and added budgets were chosen on validation data; accuracies are of test data"
    )
