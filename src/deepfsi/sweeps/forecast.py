"""Before a sweep: its cost on this machine, and the photons that a target accuracy needs.

The cost follows from a few timed steps of each kind of training. For a target every design is
trained at a few budgets, then again where its curve meets the target, so that the interpolation
spans little (`find_crossing`).
"""

import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.numeric.intervals import find_crossing
from deepfsi.base.progress import SILENT, Moments, Progress, duration_text
from deepfsi.base.quantities import Table, budget_text
from deepfsi.camera.names import find_noise
from deepfsi.datasets.dataset import Dataset
from deepfsi.jobs.designs import DESIGNS, EVERY_PIXEL
from deepfsi.jobs.job import Job
from deepfsi.sweeps.plan import Trial, plan_trials
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.records import Record, Records
from deepfsi.sweeps.results import Point, Results
from deepfsi.sweeps.run import SweepRun
from deepfsi.sweeps.summary import FoldRecords, summarise_records
from deepfsi.sweeps.workers import THIS_PROCESS, Workers, cores, default_count

if TYPE_CHECKING:
    import torch

    from deepfsi.sweeps.batch import Batch, BatchTrainer

TIMED_STEPS = 6
"""Steps that a kind of training is timed with."""

TIMED_SCENES = 500
"""Scenes that a test is timed with."""

ADDED_BUDGETS = 2
"""Budgets that may be added to each curve, one after another where it meets the target, with the
mask counts that are best beside it."""

LEAST_DECADES = 0.2
"""Decades between two budgets that are worth a training each."""

_OPTICS_AXES = ("light", "rails", "detectors", "readout")
"""Fields of the camera that tell two curves of a design apart: a table has those that differ."""

_CURVE_AXES = (*_OPTICS_AXES, "design")
"""Fields that tell two curves apart."""

_Curve = dict[float, Point]
"""Point of a summary at the best mask count, by budget, rising."""


@dataclass(frozen=True)
class Forecast:
    """Cost of a sweep."""

    trials: int
    done: int
    batches: int  # batches that the others train in
    workers: int  # processes that train
    operations: float
    seconds: float
    seconds_free: float  # the same on this machine without other programs
    others: float  # cores that other programs kept busy, in the mean while it was timed
    cores: int  # of this machine, for this process

    def lines(self) -> list[str]:
        """Say what is left, and how long it takes here."""
        return [
            f"{self.trials} trials, {self.done} of them done",
            f"batches: {self.batches}, by {self.workers} processes",
            f"products: {self.operations:.2g} floating-point operations",
            f"expected here: {duration_text(self.seconds)} beside other programs as now, which "
            f"keep {self.others:.1f} of {self.cores} cores busy; "
            f"{duration_text(self.seconds_free)} without them",
        ]


def forecast_cost(
    recipe: Recipe,
    data: Dataset,
    folder: Path,
    *,
    device: "str | torch.device" = "auto",
    workers: int | None = None,
    report: Progress = SILENT,
) -> Forecast:
    """Cost of a sweep, less what its folder holds; of folds that of all together.

    What only needs other tests of a design that is there is not counted, nor are the products of
    all scenes that fixed designs take once. Every kind of training is timed with its fewest and its
    most masks, on a few scenes and the threads of one worker; what lies between is interpolated.
    """
    from deepfsi.sweeps.batch import BatchTrainer

    folds = recipe.parts(data)
    records = Records(folder)
    costs = []
    for fold, span in zip(folds, report.split(len(folds)), strict=True):
        trainer = BatchTrainer(fold, recipe.held_out(fold), device)
        count = workers or default_count(trainer.processor.type)
        costs.append(_fold_cost(plan_trials(recipe, fold), trainer, records, count, report=span))
    added = ("trials", "done", "batches", "operations", "seconds", "seconds_free")
    sums = {name: sum(getattr(cost, name) for cost in costs) for name in added}
    return replace(costs[0], **sums)


def _fold_cost(
    trials: Sequence[Trial],
    trainer: "BatchTrainer",
    records: Records,
    workers: int,
    *,
    report: Progress,
) -> Forecast:
    """Cost of the trials of one data set, or of one fold."""
    import torch

    open_trials = [trial for trial in trials if records.read(trial) is None]
    untrained = [trial for trial in open_trials if records.design(trial) is None]
    left = list({trial.design_key: trial for trial in untrained}.values())
    batches = trainer.batches(left, workers)
    kinds: dict[Any, list[Batch]] = defaultdict(list)
    for batch in batches:
        trainer.training_set.prepare(batch[0].job.start_matrix)
        kinds[_kind(batch, trainer)].append(batch)
    costs: list[float] = []
    load = _Load()
    threads = torch.get_num_threads()
    torch.set_num_threads(max(1, threads // workers))
    try:
        for index, members in enumerate(kinds.values()):
            report(index / len(kinds), trainer.title(members[0]))
            costs += _seconds(members, trainer)
    finally:
        torch.set_num_threads(threads)
    others = load.of_others()
    timed = max(max(costs, default=0.0), sum(costs) / workers)
    free = timed / slowdown(others, 1, cores())
    return Forecast(
        trials=len(trials),
        done=len(trials) - len(open_trials),
        batches=len(batches),
        workers=workers,
        operations=sum(_operations(trial.job, trainer) for trial in left),
        seconds=free * slowdown(others, workers, cores()),
        seconds_free=free,
        others=others,
        cores=cores(),
    )


def slowdown(others: float, workers: int, cores: int) -> float:
    """Times that processes take as long as on a free machine, where they share it with others."""
    return max(1.0, (others + workers) / cores)


class _Load:
    """Load by other programs, from its making on."""

    def __init__(self) -> None:
        import psutil

        psutil.cpu_percent()
        self.wall = time.perf_counter()
        self.used = time.process_time()

    def of_others(self) -> float:
        """Cores that other programs want: those they had, or by what they left to this process."""
        import psutil

        wall = time.perf_counter() - self.wall
        used = time.process_time() - self.used
        busy = psutil.cpu_percent() / 100 * (psutil.cpu_count() or 1)
        had = busy - used / wall
        return max(0.0, had, cores() * wall / max(used, 1e-3) - 1 if used < 0.9 * wall else 0.0)


def _seconds(batches: "Sequence[Batch]", trainer: "BatchTrainer") -> list[float]:
    """Seconds of batches of one kind, interpolated between the fewest and the most masks."""
    from deepfsi.training.loop import batch_of

    by_masks = {batch[0].job.masks: batch for batch in batches}
    ends = sorted({min(by_masks), max(by_masks)})
    probes = [_probe(by_masks[masks], trainer) for masks in ends]
    scenes = len(trainer.training_set.labels)
    seconds = []
    for batch in batches:
        job = batch[0].job
        steps = job.training.epochs * (scenes // batch_of(job.training, scenes))
        step = float(np.interp(job.masks, ends, [probe.step for probe in probes]))
        test = float(np.interp(job.masks, ends, [probe.tests for probe in probes]))
        seconds.append(steps * step + len(batch) * test)
    return seconds


def _kind(batch: "Batch", trainer: "BatchTrainer") -> Any:
    """Settings that change how long a step takes, or a test, at a number of masks."""
    from deepfsi.exposure.training_set import dtypes

    job = batch[0].job
    apart: Any = {"photons": True, "seed": True, "masks": True, "camera": {"sigma"}}
    tests = batch[0].model_dump_json(include={"test_noise", "test_levels", "draws"})
    kinds = dtypes(job, trainer.processor)
    return (job.model_dump_json(exclude=apart), kinds, len(batch), tests)


def _operations(job: Job, trainer: "BatchTrainer") -> float:
    """Of the products with learned masks: forward and backward, with M and under PN with |M|."""
    made = job.mask_job()
    if not made.code.learned:
        return 2.0 * trainer.data.x_train.size * job.masks * 2
    pair = 2 if find_noise(made.noise).stands_for else 1
    scene = int(trainer.training_set.pixels(made.optics.light).sum())
    count = len(trainer.training_set.labels)
    return 2.0 * made.training.epochs * count * scene * made.masks * pair * 2


class _Probe(NamedTuple):
    """Seconds of a step of a batch, and of the tests of one of its trials."""

    step: float
    tests: float


def _probe(batch: "Batch", trainer: "BatchTrainer") -> _Probe:
    """Train a batch for two short epochs, and test one of its designs."""
    from deepfsi.evaluation.accuracy import evaluate
    from deepfsi.exposure.training_set import TrainingSet
    from deepfsi.training.learning import train
    from deepfsi.training.loop import batch_of

    trial = batch[0]
    size = batch_of(trial.job.training, len(trainer.training_set.labels))
    scenes = trainer.parts
    few = replace(
        scenes,
        x_train=scenes.x_train[: TIMED_STEPS * size],
        y_train=scenes.y_train[: TIMED_STEPS * size],
        x_test=scenes.x_test[:TIMED_SCENES],
        y_test=scenes.y_test[:TIMED_SCENES],
    )
    short = trial.job.training.model_copy(update={"epochs": 2, "batch": size})
    jobs = [each.job.model_copy(update={"training": short}) for each in batch]
    training_set = TrainingSet(few, trainer.device, dict(trainer.matrices))
    moments = Moments()
    matrix = trainer.matrix if jobs[0].code.is_custom else None
    designs = train(training_set, jobs, matrix, report=moments.report)
    epochs = moments.epochs(4 if jobs[0].code.learned_under else 2)  # that is trained twice
    step = sum(epochs[1::2]) / (len(few.y_train) // size)
    began = time.perf_counter()
    noise = trial.test_noise[0]
    evaluate(designs[0], few, trial.job.photons, noise=noise, draws=trial.draws, report=SILENT)
    seconds = time.perf_counter() - began
    tests = len(trial.test_photons) * len(trial.test_noise) * len(trial.test_levels)
    scale = (len(trainer.data.x_test) + trainer.held_out) / len(few.x_test)
    return _Probe(step, seconds * scale * tests)


def next_budget(
    photons: Sequence[float], accuracies: Sequence[float], target: float
) -> float | None:
    """Budget where one more training tells most: the crossing, but `LEAST_DECADES` from others."""
    crossing = find_crossing(photons, [[accuracy] for accuracy in accuracies], 1, target).photons
    if crossing is None:
        return None
    tried = np.log10(photons)
    above = int(np.searchsorted(photons, crossing))
    low = tried[above - 1] + LEAST_DECADES
    high = tried[above] - LEAST_DECADES
    return float(f"{10 ** np.clip(np.log10(crossing), low, high):.3g}") if low <= high else None


def photons_needed(
    recipe: Recipe,
    data: Dataset,
    target: float,
    folder: Path,
    *,
    command: str,
    device: "str | torch.device" = "auto",
    workers: Workers = THIS_PROCESS,
    report: Progress = SILENT,
) -> tuple[dict[str, Any], Results]:
    """Photons and masks that a target accuracy needs, for each design, its light and detectors.

    Mask counts and the budgets that are added are chosen on validation data, and the crossings
    found on test data.

    Parameters
    ----------
    recipe : Recipe
        Of three budgets or more.
    data : Dataset
    target : float
        Accuracy.
    folder : path
        Where records and designs are kept; it is made if need be.
    command : str
        Command that asks for it, for the results.
    device : {"auto", "cpu", "cuda"} or torch.device
    workers : Workers
        Processes that train.
    report : Progress

    Returns
    -------
    plan : dict
        JSON types only, as `plan.json` holds them; its `needs` have an entry for each curve.
    results : Results
        Of all that was trained.

    Raises
    ------
    InputError
        If it cannot be planned, or a training diverged.
    """
    from deepfsi.sweeps.batch import BatchTrainer

    check_plan(recipe, data, target)
    run = SweepRun(BatchTrainer(data, recipe.held_out(data), device), folder, workers)
    records: list[Record] = []
    recipes = [recipe]
    for span in report.split(ADDED_BUDGETS + 1):
        trials = {trial.key: trial for one in recipes for trial in plan_trials(one, data)}
        records += run.finish(list(trials.values()), span)
        results = summarise_records(
            recipe,
            data,
            [FoldRecords(data, records)],
            command=command,
            seconds=sum(record["info"]["seconds"] for record in records),
        )
        curves: dict[tuple[str, ...], _Curve] = defaultdict(dict)
        for point in sorted(results.points, key=lambda point: point.photons):
            if point.best:
                curves[tuple(getattr(point, axis) for axis in _CURVE_AXES)][point.photons] = point
        recipes = [
            more for kind in curves if (more := _with_budget(recipe, kind, curves[kind], target))
        ]
        if not recipes:
            break
    report(1.0, "done")
    covers = "test images" + " and training seeds" * (recipe.trials > 1)
    plan = {
        "target": target,
        "command": results.command,
        "data": results.data.as_dict(),
        "covers": f"{covers}, and what lies between tried budgets",
        "needs": [_need(kind, curves[kind], results.data.test, target) for kind in curves],
    }
    return plan, results


def plan_lines(plan: Mapping[str, Any]) -> Iterator[str | Table]:
    """Say what each design needs, as `photons_needed` gives it, the fewest photons first."""
    several = [axis for axis in _OPTICS_AXES if len({need[axis] for need in plan["needs"]}) > 1]
    yield Table(
        f"{plan['data']['name']}: accuracy {plan['target']:g} needs",
        ("design", "photons", "95 % interval", "masks", "tried", *several),
        [
            (
                DESIGNS[need["design"]].title,
                _photons_of(need),
                _interval_of(need),
                str(need["masks"]),
                str(len(need["tried"])),
                *(_axis_of(need, axis) for axis in several),
            )
            for need in sorted(plan["needs"], key=lambda need: need["photons"] or float("inf"))
        ],
    )
    yield f"interval: {plan['covers']}; tried: budgets of its curve"
    yield (
        "mask counts and added budgets were chosen on validation data; accuracies are of test data"
    )


def _photons_of(need: Mapping[str, Any]) -> str:
    if need["found"] == "below":
        return f"{budget_text(need['tried'][0]['photons'])} or fewer"
    if need["photons"]:
        return _two_digits(need["photons"])
    return f"above {budget_text(need['tried'][-1]['photons'])}"


def _interval_of(need: Mapping[str, Any]) -> str:
    low, high = (end and _two_digits(end) for end in (need["low"], need["high"]))
    if low is None:
        return "any" if high is None else f"{high} or fewer"
    return f"{low} or more" if high is None else f"{low} to {high}"


def _two_digits(photons: float) -> str:
    return budget_text(float(f"{photons:.1e}"))


def _axis_of(need: Mapping[str, Any], axis: str) -> str:
    if axis == "detectors" and need["design"] in EVERY_PIXEL:
        return "each pixel"
    return need[axis] or "–"


def check_plan(recipe: Recipe, data: Dataset, target: float) -> None:
    """Raise `InputError` for what cannot be planned."""
    if data.measure != "accuracy":
        raise InputError(
            f"a plan is of accuracies, and answers to {data.name} are measured by {data.measure}: "
            "use compare"
        )
    if not data.chance < target < 1:
        raise InputError(
            f"target {target:g} is not allowed: give an accuracy below 1 and above "
            f"{data.chance:.3g}, "
            f"that of guessing the commonest class of {data.name}"
        )
    if len(set(recipe.photons)) < 3 or not recipe.held_out(data):
        raise InputError("a plan needs three budgets or more, and scenes held out to choose on")
    axes = [
        recipe.test_levels,
        *recipe.exposure.values(),
        *recipe.training.values(),
        *(values for name, values in recipe.camera.items() if name not in _OPTICS_AXES),
        *(values for settings in recipe.tuned.values() for values in settings.values()),
    ]
    if any(len(values) > 1 for values in axes) or recipe.test_photons or recipe.test_noise:
        raise InputError(
            "a plan has one noise, one training of each design, and tests at the budget of the "
            "training: leave other axes than designs, photons, masks, ratios, light, rails, "
            "detectors and readout out"
        )


def _with_budget(
    recipe: Recipe, kind: tuple[str, ...], curve: _Curve, target: float
) -> Recipe | None:
    """One more budget of a curve, with the mask counts that are best at its neighbours."""
    tried = list(curve)
    budget = next_budget(tried, [point.validation or 0.0 for point in curve.values()], target)
    if budget is None:
        return None
    above = next(index for index, other in enumerate(tried) if other > budget)
    optics = {name: (value,) for name, value in zip(_CURVE_AXES, kind, strict=True) if value}
    return recipe.model_copy(
        update={
            "designs": optics.pop("design"),
            "camera": {**recipe.camera, **optics},
            "photons": (budget,),
            "masks": tuple(sorted({curve[tried[index]].masks for index in (above - 1, above)})),
            "ratios": (),
            "gaussian_photons": (),
        }
    )


def _need(kind: tuple[str, ...], curve: _Curve, images: int, target: float) -> dict[str, Any]:
    """Entry of a plan: where a curve meets the target, and what was tried."""
    tried = list(curve)
    crossing = find_crossing(tried, [point.accuracies for point in curve.values()], images, target)
    at = crossing.photons or (tried[0] if crossing.found == "below" else tried[-1])
    nearest = min(tried, key=lambda budget: abs(np.log(budget / at)))
    fields = {"photons", "masks", "accuracy", "low", "high", "validation", "keys"}
    return {
        **dict(zip(_CURVE_AXES, kind, strict=True)),
        "title": curve[nearest].title,
        **asdict(crossing),
        "masks": curve[nearest].masks,
        "tried": [point.model_dump(mode="json", include=fields) for point in curve.values()],
    }
