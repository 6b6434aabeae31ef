"""Designs of every exposure, light law and noise, trained for a moment: their files and answers."""

from functools import partial
from typing import Any

import numpy as np

import deepfsi
from golden.facts import Cases, refused_or
from golden.scenes import ADAPTIVE, BUDGET, PATCHES, STEPS, digits, facts_of, spots, tested

CASES = Cases()
EXPOSURES: dict[str, dict[str, Any]] = {
    "fixed": {"masks": 4},
    "range": {"masks": 4, "exposure": {"span": 10}},
    "patches": {"masks": 4, **PATCHES},
    "passing": {"exposure": {"bins": 8, "jitter": 0.5, "speed_jitter": 0.05}},
    "adaptive": ADAPTIVE,
}
"""Kinds of exposure, by settings of a job."""

LIGHTS: dict[str, dict[str, Any]] = {
    "column": {"light": "column"},
    "column single": {"light": "column", "rails": "single"},
    "equal-dwell": {"light": "equal-dwell"},
    "equal-dwell dual": {"light": "equal-dwell", "rails": "dual"},
    "free-dwell": {"light": "free-dwell"},
    "free-dwell both": {"light": "free-dwell", "rails": "dual", "readout": "both"},
    "two-arm": {"light": "two-arm"},
    "two-arm difference": {"light": "two-arm", "readout": "difference"},
}
"""Light laws with the rails and readouts that they can have, by fields of a camera."""

NOISES: dict[str, dict[str, Any]] = {
    "none": {"noise": "none"},
    "gaussian": {"noise": "gaussian", "sigma": 2.0},
    "ml_gauss": {"noise": "ml_gauss"},
    "poisson": {"noise": "poisson"},
    "camera": {"noise": "camera", "dark": 20.0, "sigma": 1.5},
    "dark": {"noise": "camera", "dark": 20.0},
    "click": {"noise": "click", "gates": 200},
    "own": {"noise": "golden.parts:shot"},
}
"""Noises, by fields of a camera."""


def exposed(exposure: str, light: str) -> dict[str, Any]:
    """A kind of exposure under a light law, under each noise, or that it is refused."""
    return {
        noise: refused_or(partial(_trained, exposure, {**LIGHTS[light], **fields}))
        for noise, fields in NOISES.items()
    }


CASES.update(
    {f"{kind} {light}": partial(exposed, kind, light) for kind in EXPOSURES for light in LIGHTS}
)


def _trained(exposure: str, camera: dict[str, Any]) -> dict[str, Any]:
    data = digits(classes=4).hold_out(9)
    settings = {"training": STEPS, "photons": BUDGET, "camera": camera, "seed": 3}
    test = {"noise": camera["noise"]} if ":" in camera.get("noise", "") else {}
    return facts_of(deepfsi.learn(data, **{**settings, **EXPOSURES[exposure]}), data, **test)


CAMERAS: dict[str, dict[str, Any]] = {
    "2x2": {"detectors": "2x2"},
    "2x2 two-arm": {"detectors": "2x2", "light": "two-arm"},
    "map": {"detectors": tuple(np.arange(64) % 3)},
    "levels": {"levels": 3},
    "device": {"device": "64x48", "exposure": "10ms", "flux": 1e6, "dark": 100.0},
    "shortest": {"shortest_dwell": "1ms", "exposure": "10ms"},
}
"""Cameras that all exposures are seen with, where they can be."""


@CASES.of(CAMERAS)
def camera(name: str) -> dict[str, Any]:
    """Each kind of exposure with one camera, or that it is refused."""
    return {kind: refused_or(partial(_trained, kind, CAMERAS[name])) for kind in EXPOSURES}


TRAININGS: dict[str, dict[str, Any]] = {
    "scale": {"training": {**STEPS, "scale": "each", "dropout": 0.2, "decay": 0.01}},
    "precise": {"training": {**STEPS, "precision": "bfloat16", "hidden": (16, 8)}},
    "noise": {"training": {**STEPS, "noise": "poisson"}},
    "start": {"training": {**STEPS, "start": "class-pairs"}},
    "balance": {"training": {**STEPS, "balance": True}},
    "network": {
        "training": {
            "epochs": 2,
            "batch": 30,
            "classifier": "golden.parts:network",
            "classifier_arguments": {"hidden": 4},
        }
    },
    "few counts": {
        "camera": {**LIGHTS["column single"], "noise": "poisson"},
        "training": {**STEPS, "counts": 50.0},
    },
    "few clicks": {
        "camera": {**LIGHTS["column single"], "noise": "click"},
        "training": {**STEPS, "counts": 3.0},
    },
    "control": {"design": "control", "camera": {"light": "column"}},
}
"""Other ways to train, by settings."""


@CASES.of(TRAININGS)
def training(name: str) -> dict[str, Any]:
    """A design that was trained in some way."""
    data = digits().hold_out(9)
    settings = {"training": STEPS, "photons": BUDGET, "masks": 4, "seed": 1, "camera": "dmd"}
    given = {name: one for name, one in {**settings, **TRAININGS[name]}.items() if one is not None}
    return facts_of(deepfsi.learn(data, **given), data)


NAMED = {
    **dict.fromkeys(("impulse", "raster", "hadamard"), 64),
    **dict.fromkeys(("truncated-hadamard", "pca", "random", "lda", "class-pairs"), 6),
    "s-matrix": 67,
}
"""Named designs, by their masks."""


@CASES
def named() -> dict[str, Any]:
    """Each named design, trained under the paper's optics and one device's."""
    data = digits().hold_out(9)

    def made(design: str, camera: dict[str, Any]) -> dict[str, Any]:
        settings = {"photons": 1e5, "masks": NAMED[design], "camera": camera, "training": STEPS}
        design = deepfsi.learn(data, design=design, **settings)
        return {"matrix": design.matrix, "test": tested(design, data)}

    return {
        f"{design} {light}": refused_or(partial(made, design, LIGHTS[light]))
        for design in NAMED
        for light in ("column", "equal-dwell", "free-dwell both", "two-arm")
    }


@CASES
def values() -> dict[str, Any]:
    """Each kind of exposure that estimates values, with the usual loss and one's own."""
    data = spots()
    settings = {"photons": BUDGET, "seed": 2, "camera": "dmd", "training": STEPS}

    def made(**given: Any) -> dict[str, Any]:
        return facts_of(deepfsi.learn(data, **{**settings, **given}), data)

    out = {
        name: refused_or(partial(made, **given))
        for name, given in EXPOSURES.items()
        if name != "patches"
    }
    own = {**STEPS, "loss": "golden.parts:absolute"}
    return {**out, "own loss": made(masks=4, training=own)}


@CASES
def characterised() -> dict[str, Any]:
    """A design with all that is measured after its training: folds, temperatures, readouts."""
    data = digits(600, classes=4)
    design = deepfsi.learn(data, photons=BUDGET, masks=4, camera="dmd", training=STEPS)
    whole = facts_of(design, data)
    ideal = deepfsi.ideal_observer(design, data, [100.0, BUDGET], seed=1)
    numbers = [{**one.as_dict(), "confusion": None} for one in ideal]
    return {**whole, "ideal observer": numbers}


@CASES
def characterised_ranges() -> dict[str, Any]:
    """Temperatures of budgets."""
    data = digits(500, classes=3)
    settings = {"photons": BUDGET, "camera": "dmd", "training": STEPS}
    design = deepfsi.learn(data, **settings, **EXPOSURES["range"])
    return {"range": facts_of(design, data)}


@CASES
def own_scanner() -> dict[str, Any]:
    """Masks and network that a user trained, made a design; masks from an array."""
    import torch

    rng = torch.Generator().manual_seed(0)
    rails = torch.rand(1, 5, 64, generator=rng) / 5
    scanner, network = deepfsi.Scanner.from_rails(rails), torch.nn.Linear(5, 10)
    with torch.no_grad():
        for weight in network.parameters():
            weight.copy_(torch.randn(weight.shape, generator=rng))
    data = digits()
    photons = deepfsi.photons_per_pixel(torch.tensor(data.x_train[:4]), BUDGET, 30.0)
    made = deepfsi.design_of(scanner, network, data, photons=BUDGET)
    mlp = deepfsi.Mlp(5, 3, (4,), 0.0, torch.Generator().manual_seed(0))
    matrix = np.random.default_rng(3).random((4, 64)) / 4
    custom = {"design": "custom", "matrix": matrix, "masks": 4, "training": STEPS}

    def learned(light: str) -> dict[str, Any]:
        return facts_of(deepfsi.learn(data, photons=BUDGET, camera=LIGHTS[light], **custom), data)

    return {
        "design": {"matrix": made.matrix, "test": tested(made, data)},
        "photons": photons.numpy(),
        "counts": scanner(photons, torch.Generator().manual_seed(1)).numpy(),
        **{
            f"custom {light}": refused_or(partial(learned, light))
            for light in ("column single", "equal-dwell", "free-dwell")
        },
        "network": mlp(torch.ones(2, 5)).detach().numpy(),
    }
