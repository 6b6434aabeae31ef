"""Flexible designs: for a range of budgets, for any number of masks, and to stop early.

One design stands against many that were each trained for one budget or one number of masks, with
the same network and on the same scenes. The targets are our own.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from deepfsi.datasets import Dataset
from deepfsi.design.artifact import Design
from deepfsi.design.evaluation import evaluate
from deepfsi.design.stopping import stop
from deepfsi.experiments.experiment import Experiment, Finding, budgets, points
from deepfsi.experiments.flexible.figures import Line, Stops, lines_figure, stopping_figure
from deepfsi.report.maps import accuracy_grid, heat_figure
from deepfsi.report.section import Claim, Picture, Table
from deepfsi.report.style import photons_text
from deepfsi.statistics.differences import (
    CONFIDENCE,
    Difference,
    above,
    difference,
    of_trials,
    signed,
)
from deepfsi.sweeps.queue import Report
from deepfsi.sweeps.results import Results

RANGE_LOSS, NESTED_LOSS = 0.01, 0.015
"""Accuracy that one design may lose against each of those that it stands for."""

SAVED, EQUAL = 0.3, 0.002
"""Share of the photons that stopping early is to save, and the loss that still counts as none."""

PAPER = (
    "Not in the paper, which finds that accuracy drops dramatically in dimmer light than a design "
    "was trained for, and that the number of masks matters."
)

Trials = Mapping[str, Any]
"""Accuracies by trial, with the interval of one, as a point of the results has them."""


def measure(
    results: Results, data: Dataset, designs: Path, workers: int | None, report: Report
) -> dict[str, Any]:
    """Test the first masks of nested designs, and stop exposures early."""
    base = points(results, recipe="budgets")
    counts = sorted({p["masks"] for p in [*base, *points(results, recipe="counts")]})
    prefixes = []
    for name in ("nested", "both"):
        report(0.0, "first masks")
        members = points(results, recipe=name)
        made = _load(designs, members[0])
        lights = budgets(members)
        for masks in counts:
            if not made[0].fewest_masks <= masks <= made[0].masks:
                continue
            tests = [
                evaluate(design.first(masks), data, lights, draws=1, seed=seed)
                for seed, design in enumerate(made)
            ]
            prefixes += [
                {
                    "recipe": name,
                    "masks": masks,
                    "ratio": masks / data.pixels,
                    "photons": photons,
                    **_trials([each[place] for each in tests]),
                }
                for place, photons in enumerate(lights)
            ]
    report(0.5, "stopping")
    stopped = {}
    for name in ("stop", "looks"):
        [point] = points(results, recipe=name)
        held_out = results["data"]["validation"]
        stopped[name] = [
            stop(design, data, point["photons"], held_out=held_out, draws=1, seed=seed).as_dict()
            for seed, design in enumerate(_load(designs, point))
        ]
    return {
        "prefixes": prefixes,
        "stopped": stopped["stop"],
        "looked": stopped["looks"],
    }


def _load(folder: Path, point: Mapping[str, Any]) -> list[Design]:
    return [Design.load(folder / f"{key}.safetensors") for key in point["keys"]]


def _trials(tests: Sequence[Any]) -> dict[str, Any]:
    accuracies = [test.accuracy for test in tests]
    low, high = (
        of_trials(accuracies).interval() if len(tests) > 1 else (tests[0].low, tests[0].high)
    )
    return {
        "accuracies": accuracies,
        "accuracy": float(np.mean(accuracies)),
        "low": low,
        "high": high,
    }


def show(results: Results) -> Finding:
    """Lines against budget and masks, what stopping saves, and heat maps; four claims."""
    extra = results["extra"]
    ranged, range_table, range_panel = _range(results)
    nested, nested_table, nested_panel = _nested(results)
    saved, lost = _stopping(extra["stopped"])
    saved_by_looks, lost_by_looks = _stopping(extra["looked"])
    at = extra["stopped"][0]["photons"]
    nested_at = photons_text(points(results, recipe="nested")[0]["photons"])
    claims = (
        Claim(
            f"One design for all budgets loses at most {RANGE_LOSS} against each dedicated one",
            above(ranged.values(), -RANGE_LOSS),
            f"lowest {_lowest(ranged, photons_text)} photons",
        ),
        Claim(
            f"The first masks of one design lose at most {NESTED_LOSS} against dedicated ones at "
            f"{nested_at} photons",
            above(nested.values(), -NESTED_LOSS),
            f"lowest {_lowest(nested, str)} masks",
        ),
        *(
            Claim(
                f"Stopping exposures of {kind} early saves {SAVED:.0%} of the photons and loses "
                f"less than {EQUAL} at {photons_text(at)} photons",
                _both(above([share], SAVED), above([-loss], -EQUAL)),
                f"saved {share}, lost {loss}",
            )
            for kind, share, loss in (
                ("nested masks", saved, lost),
                ("several looks", saved_by_looks, lost_by_looks),
            )
        ),
    )
    pictures = (
        Picture(
            lines_figure({"photon budget Φ": range_panel, "masks shown": nested_panel}),
            "Left: one design for all budgets, against those for one budget each, there and "
            f"(dotted) elsewhere. Right: the first masks of one design at {nested_at} photons, "
            "against designs of that many. Bars: 95 % intervals.",
            "Accuracy against budget and against masks; numbers in the tables.",
        ),
        _stopping_picture(results),
        _heat_picture(results),
    )
    found = (
        f"One design for all budgets is at its lowest {_lowest(ranged, photons_text)} photons, "
        "against the one trained for that budget; the first masks of a nested design are at their "
        f"lowest {_lowest(nested, str)} masks, against the design of so many. Stopping early saves "
        f"{saved.mean:.0%} of {photons_text(at)} photons with nested masks and changes accuracy by "
        f"{signed(0.0 - lost.mean, 4)}; with several looks, whose counts choose the dwells of the "
        f"next, {saved_by_looks.mean:.0%} and {signed(0.0 - lost_by_looks.mean, 4)}."
    )
    return Finding(found, pictures, claims, (range_table, nested_table, _stop_table(results)))


def _lowest(differences: Mapping[Any, Difference], text: Any) -> str:
    place = min(differences, key=lambda place: differences[place].mean)
    return f"{differences[place]} at {text(place)}"


def _both(first: bool | None, second: bool | None) -> bool | None:
    if first is False or second is False:
        return False
    return True if first and second else None


def _range(results: Results) -> tuple[dict[float, Difference], Table, list[Line]]:
    ranged = {p["photons"]: p for p in points(results, recipe="range")}
    base = points(results, recipe="budgets")
    own = {(p["design"], p["photons"]): p for p in base if p["photons"] == p["trained_at"]}
    lights = [photons for photons in ranged if ("deepfsi", photons) in own]
    differences = {p: difference(ranged[p], own[("deepfsi", p)]) for p in lights}
    fixed = [design for design in dict.fromkeys(p["design"] for p in base) if design != "deepfsi"]
    labels = {p["design"]: p["label"] for p in base}
    table = Table(
        "One design for all budgets, and designs for one budget each, tested at it",
        ("photons", "range", "dedicated", "difference", *(labels[each] for each in fixed)),
        tuple(
            (
                photons_text(p),
                ranged[p]["accuracy"],
                own[("deepfsi", p)]["accuracy"],
                str(differences[p]),
                *(own[(design, p)]["accuracy"] for design in fixed),
            )
            for p in lights
        ),
    )
    panel = [_line("one design for all", "flexible", ranged.values(), "photons")]
    panel.append(
        _line("one for each budget", "deepfsi", [own[("deepfsi", p)] for p in lights], "photons")
    )
    for number, trained_at in enumerate(lights):
        elsewhere = [p for p in base if (p["design"], p["trained_at"]) == ("deepfsi", trained_at)]
        name = "" if number else "the same, elsewhere"
        panel.append(_line(name, "elsewhere", elsewhere, "photons", bars=False))
    panel += [
        _line(labels[design], design, [own[(design, p)] for p in lights], "photons")
        for design in fixed
    ]
    return differences, table, panel


def _nested(results: Results) -> tuple[dict[int, Difference], Table, list[Line]]:
    prefixes = [p for p in results["extra"]["prefixes"] if p["recipe"] == "nested"]
    photons = prefixes[0]["photons"]
    dedicated = {
        (p["design"], p["masks"]): p
        for p in _counts(results, photons)
        if p["photons"] == p["trained_at"]
    }
    shown = {p["masks"]: p for p in prefixes if ("deepfsi", p["masks"]) in dedicated}
    differences = {k: difference(p, dedicated[("deepfsi", k)]) for k, p in shown.items()}
    fixed = [d for d in dict.fromkeys(design for design, _ in dedicated) if d != "deepfsi"]
    labels = {p["design"]: p["label"] for p in dedicated.values()}
    table = Table(
        f"The first masks of one design at {photons_text(photons)} photons, and designs of so many",
        ("masks", "first masks", "dedicated", "difference", *(labels[each] for each in fixed)),
        tuple(
            (
                k,
                p["accuracy"],
                dedicated[("deepfsi", k)]["accuracy"],
                str(differences[k]),
                *(dedicated[(design, k)]["accuracy"] for design in fixed),
            )
            for k, p in shown.items()
        ),
    )
    panel = [
        _line("first masks of one design", "flexible", shown.values(), "masks"),
        _line(
            "one for each number", "deepfsi", [dedicated[("deepfsi", k)] for k in shown], "masks"
        ),
    ]
    panel += [
        _line(labels[design], design, [dedicated[(design, k)] for k in shown], "masks")
        for design in fixed
    ]
    return differences, table, panel


def _counts(results: Results, photons: float) -> list[Trials]:
    """Points of designs trained at a budget, of every number of masks."""
    return [
        point
        for name in ("counts", "budgets")
        for point in points(results, recipe=name, trained_at=photons)
    ]


def _stopping(stopped: Sequence[Mapping[str, Any]]) -> tuple[Difference, Difference]:
    """Share of the photons that stopping saves, and accuracy that it loses."""
    saved = _over([{**each["used"], "mean": 1 - each["used"]["mean"]} for each in stopped])
    lost = _over([{**each["difference"], "mean": -each["difference"]["mean"]} for each in stopped])
    return saved, lost


def _stop_table(results: Results) -> Table:
    plain = {p["photons"]: p["accuracy"] for p in points(results, recipe="plain")}
    rows: list[tuple[str, float, float]] = []
    errors = []
    for name, kind in (("stopped", "nested"), ("looked", "several looks")):
        trials = results["extra"][name]
        photons = trials[0]["photons"]
        used, whole, stopped = (
            float(np.mean([each[part]["mean"] for each in trials]))
            for part in ("used", "whole", "stopped")
        )
        rows += [
            (f"{kind}, whole exposures", photons, whole),
            (f"{kind}, stopped early", used * photons, stopped),
        ]
        error, raw = (
            float(np.mean([each[part] for each in trials]))
            for part in ("calibration_error", "uncalibrated_error")
        )
        errors.append(f"{error:.4f} with {kind} ({raw:.4f} without temperatures)")
    rows += [("neither, whole exposures", p, plain[p]) for p in sorted(plain, reverse=True)]
    return Table(
        f"Stopping early; the calibration error of the answers is {' and '.join(errors)}",
        ("", "mean photons", "accuracy"),
        tuple(rows),
    )


def _over(rates: Sequence[Mapping[str, float]]) -> Difference:
    """Mean over trials; of a single one with its interval over images."""
    if len(rates) > 1:
        return of_trials([rate["mean"] for rate in rates])
    [rate] = rates
    half = (rate["high"] - rate["low"]) / 2
    return Difference(rate["mean"], half / float(stats.norm.ppf((1 + CONFIDENCE) / 2)))


def _stopping_picture(results: Results) -> Picture:
    extra = results["extra"]
    photons = extra["stopped"][0]["photons"]
    plain = _line("neither, whole exposures", "deepfsi", points(results, recipe="plain"), "photons")
    stopped = (
        Stops("nested, stopped early", "elsewhere", extra["stopped"]),
        Stops("several looks, stopped early", "looks", extra["looked"]),
    )
    return Picture(
        stopping_figure(stopped, plain),
        f"Exposures of {photons_text(photons)} photons on one device that stop when their answer "
        "is sure enough. Left: accuracy against the mean of photons used, for all thresholds (the "
        "diamond is at those chosen), and of a design for whole exposures of that many. Middle: "
        "how many go on, a line for each trial. Right: accuracy of the surest answers.",
        "What stopping early saves, when exposures stop, and what rejection gives.",
    )


def _heat_picture(results: Results) -> Picture:
    photons = points(results, recipe="nested")[0]["photons"]
    members = _counts(results, photons)
    prefixes = [p for p in results["extra"]["prefixes"] if p["recipe"] == "both"]
    lights = [p for p in budgets(members) if p in set(budgets(prefixes))]
    apart = {f"{p['ratio']:.0%}": p["ratio"] for p in prefixes}  # rows that read alike are one
    ratios = sorted(apart.values())
    grids = {
        point["title"]: accuracy_grid(
            [p for p in members if p["design"] == point["design"]], lights, ratios
        )
        for point in members
    }
    grids["one design for all"] = accuracy_grid(prefixes, lights, ratios)
    return Picture(
        heat_figure(grids, lights, ratios),
        "Accuracy by budget of the test and compression ratio. The last panel is one design, "
        f"nested and for all budgets; each row of the others is a design of its own, trained at "
        f"{photons_text(photons)} photons.",
        "Heat maps of accuracy over test budget and compression ratio.",
    )


def _line(name: str, look: str, members: Iterable[Trials], axis: str, bars: bool = True) -> Line:
    every = sorted(members, key=lambda point: point[axis])
    ends: list[list[float]] = [
        [point[end] for point in every] if bars else [] for end in ("low", "high")
    ]
    accuracy = [point["accuracy"] for point in every]
    return Line(name, look, [point[axis] for point in every], accuracy, *ends)


EXPERIMENT = Experiment(
    name="flexible",
    title="Flexible designs: any budget, any number of masks, and exposures that stop early",
    paper=PAPER,
    show=show,
    measure=measure,
)
