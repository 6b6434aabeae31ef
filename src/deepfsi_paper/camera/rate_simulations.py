"""The published rates in the virtual laboratory, at settings that the paper does not give.

Varied are the flux, ambient light, the counter's dead time, the monitor's black, and the budget
that the training assumed. Each setting takes one of the trainings at random, so that what trainings
differ by is part of the scatter that the fit allows.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import qmc

from deepfsi.base.progress import SILENT, Progress
from deepfsi.datasets.catalog import DIM_BLACK
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.design.design import Design
from deepfsi.sweeps.results import Results
from deepfsi.sweeps.workers import cores, processes
from deepfsi_paper.camera import laboratory
from deepfsi_paper.camera.laboratory import (
    ASSUMED,
    EXPOSURES,
    FLUX,
    LAB,
    Group,
    Laboratory,
    MountedDesign,
    classify,
    design_groups,
    draw_digits,
    mounted_design,
)
from deepfsi_paper.camera.published import PUBLISHED, exposures_of
from deepfsi_paper.camera.rate_fit import Emulator, Parameter, RateFit, fit_rates, moments

SETTINGS_A_BUDGET = 36
"""Simulated settings for each budget that designs were trained for."""

TABLES = 200
"""Tables drawn from the fit, for its p."""

PICTURES, SHOTS = 10, 4
"""Pictures of each class, and exposures of each picture, at a setting."""

PARAMETERS = (
    Parameter("flux", "flux of a mean scene (photons/s)", 1e6, 3e7),
    Parameter("ambient", "ambient light over that of a mean scene", 1e-3, 1.0),
    Parameter("dead_time_s", "dead time of the counter (s)", 1e-9, 1e-7),
    Parameter("black", "black of the monitor over white", 0.0, 0.6, log=False),
)
"""What is varied, besides the assumed budget."""

BEFORE = {
    "flux": FLUX,
    "ambient": 1e-3,
    "dead_time_s": LAB.dead_time_s,
    "black": DIM_BLACK[0],
    "assumed": ASSUMED,
}
"""The laboratory as it is; it has no ambient light."""


@dataclass(frozen=True)
class Plan:
    """Settings at which the laboratory is simulated.

    Attributes
    ----------
    laboratory : Laboratory
        With pictures (J · K, h, w) and their classes (J, K).
    values : array, shape (T, 4)
        Of `PARAMETERS`.
    budgets : array of int, shape (T,)
        Places of the assumed budgets among those that designs were trained for, rising.
    """

    laboratory: Laboratory
    values: np.ndarray
    budgets: np.ndarray


@dataclass(frozen=True)
class Answers:
    """Right answers (T, exposures, J, K) of one design."""

    design: str
    right: np.ndarray


def measure(
    results: Results, data: Dataset, designs: Path, workers: int | None, report: Progress
) -> dict[str, Any]:
    """Tests in the laboratory as it is, and the fit of the published rates.

    Parameters as of `Experiment.measure`.
    """
    first, second = report.between(0.0, 0.6), report.between(0.6, 1.0)
    tests = laboratory.measure(results, data, designs, workers, first)
    fit = fit_published(results, designs, workers, second)
    return {**tests, "fit": fit and asdict(fit)}


def fit_published(
    results: Results, designs: Path, workers: int | None = 1, report: Progress = SILENT
) -> RateFit | None:
    """Fit of the published rates by designs of equal dwells; None if trained for one budget only.

    Parameters
    ----------
    results : Results
    designs : Path
        Folder of the design files.
    workers : int, optional
    report : Report
    """
    groups = [(name, points) for name, points in design_groups(results) if name in PUBLISHED]
    budgets = sorted({point.photons for _, points in groups for point in points})
    if len(budgets) < 2:
        return None
    parameters = [
        *PARAMETERS,
        # Nothing is trained between the budgets, and nothing interpolated
        Parameter(
            "assumed",
            "budget assumed in training (photons)",
            budgets[0],
            budgets[-1],
            levels=tuple(budgets),
        ),
    ]
    shares, plan = _plan(load_dataset(results.recipe["data"]), designs, parameters, budgets)
    report(0.0, "settings of the laboratory")
    done = dict[str, np.ndarray]()
    at_once = min(workers or cores(), len(groups))
    for answers in processes(answer, plan, sorted(groups, key=_masks), at_once):
        done[answers.design] = answers.right
        report(0.9 * len(done) / len(groups), "settings of the laboratory")
    conditions = [(name, exposure) for name, _ in groups for exposure in EXPOSURES]
    rates = np.array([PUBLISHED[name][exposure][0] for name, exposure in conditions])
    right = np.concatenate([done[name] for name, _ in groups], axis=1)
    emulator = Emulator(
        shares, moments(right, SHOTS), rates, np.array([exposures_of(rate) for rate in rates])
    )
    return fit_rates(emulator, parameters, conditions, BEFORE, TABLES)


def _masks(group: Group) -> int:
    return -group[1][0].masks


def _plan(
    data: Dataset, designs: Path, parameters: Sequence[Parameter], budgets: Sequence[float]
) -> tuple[np.ndarray, Plan]:
    """Settings, as shares (T, 5) of the ranges, and the plan of them."""
    places = draw_digits(data.y_test, PICTURES, seed=1)
    count = SETTINGS_A_BUDGET * len(budgets)
    sobol = qmc.Sobol(len(parameters), rng=np.random.default_rng(0))
    shares = sobol.random_base2((count - 1).bit_length())[:count]
    chosen = (shares[:, -1] * len(budgets)).astype(int)
    shares[:, -1] = parameters[-1].share(np.array(budgets))[chosen]
    values = np.stack([each.value(shares[:, k]) for k, each in enumerate(PARAMETERS)], axis=1)
    images = data.x_test[places.ravel()].reshape(-1, *data.image_shape)
    return shares, Plan(Laboratory(designs, images, data.y_test[places]), values, chosen)


def answer(plan: Plan, group: Group) -> Answers:
    """Right answers of a design to the pictures at all settings of a plan.

    Parameters
    ----------
    plan : Plan
    group : Group
    """
    name, points = group
    shown = replace(
        plan.laboratory,
        images=np.concatenate([plan.laboratory.images, np.ones_like(plan.laboratory.images[:1])]),
    )
    masks: dict[bytes, MountedDesign] = {}
    trained = [
        [
            mounted_design(Design.load(shown.designs / f"{key}.safetensors"), shown, masks)
            for key in point.keys
        ]
        for point in sorted(points, key=lambda point: point.photons)
    ]
    truth = shown.truth.ravel()
    right = np.zeros((len(plan.values), len(EXPOSURES), len(truth)), dtype=np.int64)
    for setting, (values, budget) in enumerate(zip(plan.values, plan.budgets, strict=True)):
        rng = np.random.default_rng([setting, len(name)])
        trainings = trained[budget]
        mounted = trainings[rng.integers(len(trainings))]
        flux, ambient, dead_time_s, black = values.tolist()
        camera = LAB.model_copy(update={"dead_time_s": dead_time_s, "ambient": ambient * flux})
        lit = replace(mounted, scene_rates=displayed(mounted.scene_rates, flux, black))
        for number, exposure in enumerate(EXPOSURES):
            classes = classify(lit, camera, exposure, rng, SHOTS)
            right[setting, number] = (classes == truth[:, None]).sum(axis=1)
    return Answers(name, right.reshape(*right.shape[:2], *shown.truth.shape))


def displayed(scene_rates: np.ndarray, flux: float, black: float) -> np.ndarray:
    """Photons/s of scenes on a monitor of another black, where the mean scene gives a flux.

    Parameters
    ----------
    scene_rates : array, shape (S + 1, F, 1)
        Of scenes whose black is `DIM_BLACK`, the last of which is white, at `FLUX`; the first frame
        has all mirrors ON.
    flux : float
    black : float
        Reflectance of black, white being 1.
    """
    *_, white = scene_rates
    old = DIM_BLACK[0]
    gain = (1 - black) / (1 - old)
    scenes = gain * scene_rates[:-1] + (black - gain * old) * white
    same = scene_rates[:-1, 0].mean() / scenes[:, 0].mean()
    return np.asarray(np.maximum(flux / FLUX * same * scenes, 0.0))
