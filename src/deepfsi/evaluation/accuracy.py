"""Accuracy of a design over budgets, with intervals that say what they cover."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, get_args

import numpy as np
import torch
from torch import Tensor

from deepfsi.base.errors import InputError
from deepfsi.base.progress import Progress, progress_bar
from deepfsi.camera.camera import Camera, CameraSource
from deepfsi.camera.light import check_budget
from deepfsi.camera.names import NoiseName
from deepfsi.datasets.arrays import as_test_part
from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import Source, as_dataset
from deepfsi.design.design import Design
from deepfsi.designfile.provenance import new_scenes
from deepfsi.evaluation.measures import Answers, ClassAnswers, ValueAnswers
from deepfsi.evaluation.results import Estimates, Result
from deepfsi.exposure.kind import EXPOSED_AT_ONCE, CountedLight
from deepfsi.physics.surroundings import library_defaults

COVERS = "test images and noise draws, of one training"
"""What the interval of a test of classes covers."""


@library_defaults()
def evaluate(
    design: Design,
    data: Source,
    photons: Sequence[float] | float,
    *,
    camera: CameraSource = None,
    draws: int = 3,
    seed: int = 0,
    report: Progress | None = None,
    **settings: Any,
) -> list[Any]:
    """Test a design on a data set under noise: a `Result`, or `Estimates`, for each budget.

    Parameters
    ----------
    design : Design
    data : Dataset, str, path or tuple of arrays
        Its test part is used, all of ``(x, y)``, less what was trained on; its pixels and classes
        are the design's.
    photons : float or sequence of float
        Budgets Φ.
    camera : Camera, str, path or mapping, optional
        Camera whose noise, dark counts and read noise hold. Default: the design's.
    draws : int
        Noise draws of each scene (1 is enough without noise).
    seed : int
        Seed of the noise.
    report : Progress, optional
        Receives the progress. Default: a bar if a terminal is attached.
    **settings
        Fields of the camera in place of its own, such as ``noise="gaussian", sigma=2``.

    Raises
    ------
    InputError
        If the data does not fit the design, or a budget is not finite and above 0.

    Examples
    --------
    >>> import deepfsi
    >>> few = deepfsi.Training(epochs=1)
    >>> design = deepfsi.learn("digits", photons=1e4, masks=6, training=few)
    >>> [result] = deepfsi.evaluate(design, "digits", 1e4, draws=1)
    >>> result.low < result.accuracy < result.high
    True
    """
    budgets = [check_budget(b) for b in np.atleast_1d(np.asarray(photons, dtype=object))]
    names = design.values.names if design.values else ()
    if isinstance(data, tuple) and len(data) == 2:
        data = as_test_part(*data, design.image_shape, design.classes, names)
    scenes, left = new_scenes(design.training_scenes, as_dataset(data))
    check_data(design, scenes)
    camera = camera_for(design, camera, **settings)
    known = ["the variance of the values is taken as known"] if names else []
    covers = "; ".join([COVERS, *known, *([left] if left else [])])
    title = f"{design.name}, {design.masks} masks"
    shares = design.exposure.shares.view(design.masks, -1).sum(dim=1)
    answer = partial(_answering, design, camera)
    kind = ValueAnswers if names else ClassAnswers
    with progress_bar(report, title) as bar:
        tests = expose_scenes(
            scenes,
            answer,
            budgets,
            shares,
            draws=draws,
            seed=seed,
            noise=camera.noise_name,
            covers=covers,
            kind=kind,
            report=bar,
        )
    return [Estimates.of(answers, names) if names else Result.of(answers) for answers in tests]


Exposed = tuple[tuple[Tensor, ...], CountedLight]
"""Answers to scenes, and the light of their exposures: classes (b,), which rounded probabilities
may not tell apart, and probabilities (b, C); or values (b, q)."""

Expose = Callable[[torch.Generator, float], Exposed]
"""Exposes scenes once at a budget, and answers."""


def _answering(design: Design, camera: Camera, x: Tensor) -> Expose:
    """Function that exposes scenes (b, N), and answers with their classes or values."""
    expose = design.exposures(x, camera)

    def answer_once(generator: torch.Generator, budget: float) -> Exposed:
        answer, light = expose(budget, generator)
        if design.values is not None:
            return (design.values.estimated(answer.logits),), light
        return (answer.classes, answer.probabilities), light

    return answer_once


def camera_for(design: Design, camera: CameraSource = None, **settings: Any) -> Camera:
    """Camera of a test; default: the design's."""
    base = design.camera if camera is None else Camera.load(camera)
    if "noise" not in settings and camera is None and base.noise_name not in get_args(NoiseName):
        raise InputError(
            f"this design is for {base.noise_name} noise, code of its maker's that a file does not "
            "run: give `noise`, it or another"
        )
    return Camera.load(base, **settings)


def expose_scenes(
    data: Dataset,
    answer_of: Callable[[Tensor], Expose],
    budgets: Sequence[float],
    shares: Tensor,
    *,
    draws: int,
    seed: int,
    noise: str,
    covers: str = COVERS,
    kind: type[Answers],
    report: Progress,
) -> list[Any]:
    """Answers to the test scenes at each budget, of which masks count `shares` (m,)."""
    # a stream for each budget: no result depends on the other budgets
    generators = [torch.Generator(shares.device).manual_seed(seed) for _ in budgets]
    outputs: list[list[list[np.ndarray]]] = [[] for _ in budgets]
    light = np.zeros((len(budgets), 3))  # counts, photons, and light of exposures that stop
    exposed = []
    chunks = torch.arange(len(data.x_test)).split(EXPOSED_AT_ONCE)
    with torch.no_grad():
        for done, rows in enumerate(chunks, start=1):
            indices = rows.numpy()  # NumPy takes a tensor of one number for the number itself
            answer = answer_of(torch.from_numpy(data.x_test[indices]))
            exposed += [indices] * draws
            for column, (budget, generator) in enumerate(zip(budgets, generators, strict=True)):
                for _ in range(draws):
                    answers, counted = answer(generator, budget)
                    outputs[column].append([values.cpu().numpy() for values in answers])
                    light[column] += np.array(counted, dtype=float)
            report(done / len(chunks))
    means = light / (draws * len(data.x_test))
    return [
        kind(
            *(np.concatenate(arrays) for arrays in zip(*exposures, strict=True)),
            photons=budget,
            noise=noise,
            covers=covers,
            draws=draws,
            counts=counts,
            arriving=arriving,
            used=None if np.isnan(used) else used / budget,
            shares=shares.tolist(),
            truth=data.y_test,
            scenes=np.concatenate(exposed),
        )
        for budget, exposures, (counts, arriving, used) in zip(
            budgets, outputs, means.tolist(), strict=True
        )
    ]


def check_data(design: Design, data: Dataset) -> None:
    """Raise `InputError` unless a design can classify the scenes of a data set."""
    if data.image_shape != design.image_shape:
        raise InputError(
            f"{data.name} has scenes of shape {data.image_shape} and the design "
            f"{design.image_shape}: use the data (and `size`) that it was made for"
        )
    values = design.values.names if design.values else ()
    if data.values != values or data.classes != design.classes:
        held, wanted = (
            ", ".join((names or classes)[:12])
            for names, classes in ((data.values, data.classes), (values, design.classes))
        )
        raise InputError(f"{data.name} has {held}, and the design answers {wanted}: use such data")
