"""Cameras: presets, each field with a value that is allowed and several that are refused."""

from pathlib import Path
from typing import Any

import deepfsi
from golden.facts import Cases, refused_or

CASES = Cases()
PRESETS = ("dmd", "dmd-2x2", "dmd-4x4", "two-arm", "paper")

ALLOWED: dict[str, tuple[Any, ...]] = {
    "light": ("column", "equal-dwell", "free-dwell", "two-arm"),
    "rails": ("dual", "single"),
    "detectors": ("1x1", "2x2", "3", 4, (0, 1, 0, 1)),
    "readout": ("both", "difference"),
    "device": ("dlp7000", "1024x768", "64x48"),
    "region": ("32x24", "32x24+0+0"),
    "stretch": (True, False),
    "shortest_dwell": ("32us", 1e-4, 0),
    "exposure": ("10ms", 0.5, None),
    "levels": (0, 2, 769),
    "flux": (1e6, 1.5),
    "dark": (0, 200.5),
    "dead_time": ("20ns", 0),
    "dead_time_model": ("paralysable", "non-paralysable"),
    "gates": (1, 50),
    "noise": ("poisson", "gaussian", "ml_gauss", "camera", "click", "none", "golden.parts:shot"),
    "sigma": (0, 2.5),
}
"""Values of each field that are allowed, by themselves."""

WRONG: dict[str, tuple[Any, ...]] = {
    "light": ("colum", 3),
    "rails": ("both", None),
    "detectors": ("0x2", "2by2", (0, 2), ""),
    "readout": ("rails",),
    "device": ("dlp", "0x5", 7),
    "region": ("32", "0x0", "99x"),
    "stretch": ("perhaps",),
    "shortest_dwell": ("-1us", "soon"),
    "exposure": ("0s", -1, "10 parsec"),
    "levels": (1, -2, 2.5, 2**25),
    "flux": (0, -1, float("inf"), "bright"),
    "dark": (-1, float("nan")),
    "dead_time": ("1ms", -1e-9),
    "dead_time_model": ("dead",),
    "gates": (0, 10**7, 1.5),
    "noise": ("poison", 4, "module:"),
    "sigma": (-1, float("inf")),
    "nosuch": (1,),
}
"""Values of each field that are refused, by themselves."""

PAIRS: tuple[dict[str, Any], ...] = (
    {"light": "two-arm", "rails": "single"},
    {"light": "column", "detectors": "2x2"},
    {"light": "column", "device": "dlp7000"},
    {"light": "column", "rails": "single"},
    {"shortest_dwell": "20ms", "exposure": "10ms"},
    {"device": "dlp7000", "exposure": "20us"},
    {"device": "dlp7000", "exposure": "10ms", "flux": 1e6, "dark": 200},
    {"device": "dlp7000", "region": "512x512", "exposure": "10ms", "levels": 2},
    {"device": "64x48", "region": "99x99"},
    {"region": "32x24"},
    {"gates": 10, "dark": 5},
    {"gates": 10, "dead_time": "20ns"},
    {"gates": 10, "noise": "poisson"},
    {"gates": 10},
    {"dark": 5, "noise": "poisson"},
    {"dark": 5, "noise": "camera", "sigma": 2},
    {"dark": 5},
    {"dead_time": "20ns", "noise": "click"},
    {"noise": "gaussian"},
    {"exposure": "10ms", "flux": 1e6},
    {"light": "free-dwell", "rails": "dual", "readout": "both", "detectors": "4x4"},
)
"""Fields that imply or exclude each other."""

DERIVED = ("budget", "dark_counts", "shortest_share")
"""What follows from the fields, in shares of an exposure and counts."""


def described(**fields: Any) -> Any:
    """Dump of a camera and what follows from it, or that it is refused in one line."""

    def facts() -> dict[str, Any]:
        camera = deepfsi.Camera.load(None, **fields)
        implied = {name: str(getattr(camera, name)) for name in DERIVED}
        return {"dump": _exact(camera), "implied": implied, "order": list(camera.model_dump())}

    return refused_or(facts)


def loaded(source: str, **fields: Any) -> Any:
    return refused_or(lambda: _exact(deepfsi.Camera.load(source, **fields)))


def _exact(camera: Any) -> dict[str, Any]:
    """Fields of a camera, each float as the shortest decimal that gives it."""
    return {
        name: repr(one) if isinstance(one, float) else one
        for name, one in camera.model_dump(mode="json").items()
    }


@CASES
def presets() -> dict[str, Any]:
    """Every preset, alone and with each field that is given."""
    out: dict[str, Any] = {}
    for name in PRESETS:
        out[name] = loaded(name)
        for field, (value, *_) in ALLOWED.items():
            out[f"{name} {field}"] = loaded(name, **{field: value})
    return out


@CASES.of(WRONG)
def field(name: str) -> dict[str, Any]:
    """A field with each value."""
    values = (*ALLOWED.get(name, ()), *WRONG[name])
    return {f"{name}={value!r}": described(**{name: value}) for value in values}


@CASES
def pairs() -> dict[str, Any]:
    """Fields together."""
    return {repr(pair): described(**pair) for pair in PAIRS}


FILES = {
    "right": 'light = "two-arm"\nexposure = "10ms"\nflux = 1e6\n',
    "unknown": 'ligth = "two-arm"\n',
    "syntax": 'light = "two-arm\n',
    "empty": "",
}


@CASES
def files() -> dict[str, Any]:
    """Cameras of TOML files, right and wrong."""
    out: dict[str, Any] = {}
    for name, content in FILES.items():
        Path(f"{name}.toml").write_text(content)
        out[name] = loaded(f"{name}.toml")
    return {**out, "missing": loaded("nosuch.toml"), "name": loaded("nosuch")}


JOBS: tuple[dict[str, Any], ...] = (
    {"masks": 10, "photons": 1e4},
    {"masks": 10, "photons": 1e4, "design": "raster"},
    {"masks": 10, "photons": 1e4, "design": "hadamard", "training": {"lr": 0.3}},
    {"photons": 1e4, "exposure": {"bins": 16}},
    {"masks": 8, "photons": 1e4, "camera": "paper", "exposure": {"patch": 4}},
    {"masks": 8, "camera": {"exposure": "10ms", "flux": 1e6}},
    {"masks": 8, "photons": 1e4, "training": {"counts": 30}},
    {"masks": 0, "photons": 1e4},
    {"masks": 8},
    {"masks": 8, "photons": -1},
    {"masks": 8, "photons": 1e4, "design": "deepfis"},
    {"masks": 8, "photons": 1e4, "epochs": 3},
    {"masks": 8, "photons": 1e4, "training": {"epoch": 3}},
    {"masks": 8, "photons": 1e4, "seed": -1},
)


@CASES
def jobs() -> dict[str, Any]:
    """Jobs as they are dumped, and their refusals."""
    return {
        repr(one): refused_or(lambda one=one: deepfsi.Job(**one).model_dump_json()) for one in JOBS
    }
