"""A design as JSON for a page that exposes scenes and classifies them.

A page of adaptive masks holds a subset of the training scenes. Its answers and accuracy are those
of a design with this subset as prior.

Arrays are float32: first all lowest bytes, then the next ones, since the highest bytes of weights
are much alike and shrink when deflated; then base64. Scenes have 16 bits, coefficients of a prior
have 8.
"""

import base64
import zlib
from dataclasses import replace
from importlib.metadata import version
from math import prod
from typing import Any

import numpy as np
from scipy.special import ndtri

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.datasets.dataset import Dataset
from deepfsi.design.design import Design
from deepfsi.design.networks import Mlp
from deepfsi.designfile.design_file import Temperatures
from deepfsi.designfile.misfit import FALSE_ALARM, UsualMisfit
from deepfsi.designfile.provenance import new_scenes, trained_budgets
from deepfsi.designfile.view_test import (
    BRIGHTNESS_FREE,
    DIM_NOISE,
    GAIN_FREE,
    SceneModel,
    SceneReadouts,
)
from deepfsi.evaluation.accuracy import check_data, evaluate
from deepfsi.exposure.training_set import check_classes
from deepfsi.physics.laws import ROUNDING_SLACK
from deepfsi.physics.noise import noise_of
from deepfsi.physics.surroundings import library_defaults

SLIDER_BUDGETS = tuple(float(f"{10**power:.3g}") for power in np.arange(1, 7.1, 0.5))
"""Budgets at which the accuracy is measured, the whole range of the page's slider."""

SCENES = 30
"""Test scenes in the page, as evenly from the classes as they allow."""

TESTED = 300
"""Test scenes by which the accuracy of adaptive masks is measured, at most: a look takes a ms."""


@library_defaults()
def playable(
    design: Design, data: Dataset, *, seed: int = 0, report: Progress = SILENT
) -> dict[str, Any]:
    """Payload of a page: JSON types only."""
    check_playable(design)
    check_data(design, data)
    fresh, _ = new_scenes(design.training_scenes, data)
    tested = fresh
    trained = trained_budgets(design.info)
    inside = [budget for budget in trained if SLIDER_BUDGETS[0] <= budget <= SLIDER_BUDGETS[-1]]
    if design.exposure.makes_masks:
        # half of the budgets, as looks take time (`TESTED`)
        budgets = sorted({*SLIDER_BUDGETS[::2], *inside})
        rows = np.random.default_rng(seed).permutation(len(fresh.x_test))[:TESTED]
        tested = replace(fresh, x_test=fresh.x_test[rows], y_test=fresh.y_test[rows])
        full = design
        design = of_page(full, seed)
        optics = _posterior(design, full)
    else:
        budgets = sorted({*SLIDER_BUDGETS, *inside})
        optics = _networks(design)
    detection = design.exposure.detection
    results = evaluate(design, tested, budgets, draws=1, seed=seed, report=report)
    return {
        **optics,
        "name": design.name,
        "image_shape": design.image_shape,
        "classes": design.classes,
        "detectors": detection.count,
        "labels": None if detection.labels is None else detection.labels.tolist(),
        "budget": trained and {"low": trained[0], "high": trained[1]},
        "temperatures": _temperatures(design.temperatures),
        "rules": [design.info["stopping"]] if "stopping" in design.info else [],
        "scenes": _scenes(fresh, seed),
        "curve": [
            {
                **{name: getattr(result, name) for name in ("photons", "accuracy", "low", "high")},
                "used": result.score("mean_light") or 1.0,
            }
            for result in results
        ],
        "test": {
            "images": results[0].images,
            "draws": 1,
            "covers": results[0].covers,
            "commonest": fresh.chance,
        },
        "data": {"name": data.name, "preprocessing": data.preprocessing},
        "version": version("deepfsi"),
    }


def of_page(design: Design, seed: int = 0) -> Design:
    """The design as a page plays it, with a subset of its scenes."""
    exposure = design.prior_exposure
    count = 10**6 // len(exposure.prior.components)  # a million coefficients of 8 bits
    return replace(design, exposure=replace(exposure, prior=exposure.prior.subset(count, seed)))


def check_playable(design: Design) -> None:
    """Raise `InputError` for a design that no page can play."""
    check_classes(design.values, "a page")
    design.exposure.check("page")
    if len(design.image_shape) == 1:
        raise InputError("this design is of spectra, and on a page images are drawn")
    camera = design.camera
    noise = camera.noise_facts
    if not (noise.steady and noise.shot) or (noise.read_noise and camera.sigma):
        raise InputError(
            f"this design is for {camera.noise_name} noise with sigma {camera.sigma:g} and "
            f"fluctuation {camera.fluctuation:g}, and a page draws photon and dark counts of "
            "steady light: give a design for poisson or camera noise with both 0"
        )
    if design.exposure.makes_masks:
        design.prior_exposure.optics_at(1.0)
    elif not isinstance(design.classifier, Mlp):
        raise InputError(
            "a page has no classifier of your own in it: give a design with the package's own, "
            "which `classifier` mlp learns"
        )


def _pack(values: np.ndarray) -> dict[str, Any]:
    """An array of float32, uint16 or int8, for JSON."""
    types = {np.dtype(np.uint16): "<u2", np.dtype(np.int8): "<i1"}
    content = np.ascontiguousarray(values, types.get(values.dtype, "<f4"))
    planes = content.reshape(-1).view(np.uint8).reshape(-1, content.itemsize).T
    text = base64.b64encode(zlib.compress(planes.tobytes(), 9)).decode()
    return {"shape": values.shape, "bytes": content.itemsize, "planes": text}


def _networks(design: Design) -> dict[str, Any]:
    """Fixed masks, and the network that reads their counts."""
    network = design.classifier
    assert isinstance(network, Mlp)
    # Of two rails the difference M⁺ − M⁻ is kept, and their sum where it is not |M|
    rails = design.rails
    difference, total = (value.cpu().numpy() for value in (rails.difference, rails.total))
    sums = None
    if rails.count == 2 and not np.array_equal(total, np.abs(difference)):
        flat = np.ptp(total, axis=1).max() < ROUNDING_SLACK * total.max()
        sums = _pack(total.mean(axis=1, keepdims=True) if flat else total)
    masks = design.mask_exposure
    scanner = masks.scanner(noise_of(design.camera))
    dark = scanner.noise.settings.get("dark", 0.0)  # of a detector in an exposure
    rows = masks.scene_readouts(np.zeros((1, *design.counts_shape)), 1.0, 0.0)
    usual = _usual(design.usual_misfit, design.scene_model, _all_on(design), rows)
    if usual and design.scene_model:
        usual |= _in_counts(design.scene_model, rows)
    return {
        "summed_reflectance": design.summed_reflectance,
        "light": masks.light,
        "rails": rails.count,
        "readout": masks.detection.readout,
        "dark": dark,
        "dark_counts": _pack(scanner.dark_counts(rails.count).cpu().numpy()) if dark else None,
        "matrix": _pack(difference),
        "total": sums,
        "mean": _pack(masks.mean.cpu().numpy()),
        "std": _pack(masks.std.cpu().numpy()),
        "network": [
            {name: _pack(value.detach().cpu().numpy()) for name, value in layer.named_parameters()}
            for layer in network.layers
        ],
        "exposure": masks.entry.model_dump(),
        "usual": usual,
    }


def _all_on(design: Design) -> SceneReadouts:
    """All-ON frame at a budget of one photon."""
    pixels = prod(design.image_shape)
    return SceneReadouts.all_on(np.zeros(1), 1 / design.summed_reflectance, 0.0, pixels)


def _usual(
    usual: UsualMisfit | None, model: SceneModel | None, *rows: SceneReadouts
) -> dict[str, Any] | None:
    """What the test of counts compares with, at a budget of one photon; None if it is not held.

    `rows` are those of an all-ON frame, and of masks that are known before.
    """
    if usual is None or model is None:
        return None
    # the smallest of these p-values, times their number, is compared; that of light is two-sided
    chance = FALSE_ALARM / (1 + len(rows))
    return {
        "budgets": usual.budgets.tolist(),
        "logarithms": usual.logarithms.tolist(),
        "deviations": [-float(ndtri(chance)), -float(ndtri(chance / 2))],
        "lights": [
            {
                "limits": light.tolist(),
                "expected": float((each.masks @ model.mean).sum()),
                "spread": model.light(each, light).spread,
            }
            for each, light in zip(rows, usual.light[[0, -1]], strict=False)
        ],
    }


def _in_counts(model: SceneModel, rows: SceneReadouts) -> dict[str, Any]:
    """Classes and scenes of a model as `SceneModel.misfit` sees them, at a budget of one photon."""
    masks = rows.masks
    expected = masks @ model.mean
    gains = np.unique(rows.inputs)[:, None] == rows.inputs
    free = [BRIGHTNESS_FREE * expected[None], GAIN_FREE * expected * gains]
    noise = expected + DIM_NOISE * expected.mean()
    arrays = {
        "noise": np.where(expected > 0, noise, np.inf),  # what no scene reaches tells nothing
        "rest": masks**2 @ model.rest.astype(float),
        "means": model.means.astype(float) @ masks.T,
        "axes": np.concatenate([model.axes.astype(float) @ masks.T, *free]),
    }
    return {name: _pack(values) for name, values in arrays.items()}


def _posterior(design: Design, full: Design) -> dict[str, Any]:
    """Looks of adaptive masks for a page, and how many of the design's scenes it has."""
    exposure = design.prior_exposure
    prior = exposure.prior
    optics = exposure.optics_at(1.0)
    names = ("mean", "components", "steps", "levels", "members")
    return {
        "summed_reflectance": prior.summed_reflectance,
        "light": design.camera.light,
        "rails": optics.arms,
        "dark": optics.dark,
        "shares": exposure.settings.shares,
        "counted": exposure.shares.tolist(),
        "prior": {name: _pack(prior.arrays[name]) for name in names}  # whole numbers as float32
        | {
            "sizes": prior.sizes,
            "spread": prior.spread,
            "temperatures": _temperatures(prior.temperatures),
        },
        "known": {
            "scenes": len(prior),
            "of": len(full.prior_exposure.prior),
            "centres": exposure.settings.clusters is not None,
        },
        "usual": _usual(exposure.usual_misfit, full.prior_exposure.prior.model, _all_on(design)),
    }


def _temperatures(fitted: Temperatures | None) -> dict[str, Any] | None:
    """Calibration of the probabilities, and the lowest sufficient light."""
    if fitted is None:
        return None
    return {
        "logs": fitted.logs.tolist(),
        "budgets": fitted.budgets.tolist(),
        "dimmest": fitted.dimmest,
    }


def _scenes(data: Dataset, seed: int) -> dict[str, Any]:
    """Test scenes, of each class in turn, as levels of the range of training scenes."""
    low = float(data.x_train.min())
    high = float(data.x_train.max())
    rng = np.random.default_rng(seed)
    queues = [rng.permutation(np.flatnonzero(data.y_test == k)) for k in range(len(data.classes))]
    turns = [queue[turn] for turn in range(SCENES) for queue in queues if turn < len(queue)]
    rows = np.array(sorted(turns[:SCENES], key=lambda row: (data.y_test[row], row)))
    share = (data.x_test[rows] - low) / max(high - low, 1e-9)
    levels = np.rint(share.clip(0, 1) * (2**16 - 1)).astype(np.uint16)
    return {
        "low": low,
        "high": high,
        "levels": _pack(levels),
        "labels": data.y_test[rows].tolist(),
    }
