"""The paper's hardware study in a virtual laboratory, and what it could not vary there.

A display, perspective, blur and vignetting, a micromirror device, one photon counter. As a lab
would, we calibrate with spots, train on the camera's view of MNIST at one assumed budget, export
the patterns, and test with gates of four exposures in the same frames. The protocol is the paper's
(ten test digits, one of each, ten exposures each), repeated for many draws of the ten digits.
"""

import base64
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from deepfsi.datasets import Dataset, load_dataset
from deepfsi.design.artifact import Design
from deepfsi.experiments.camera.figures import (
    digits_figure,
    effects_figure,
    exposure_figure,
    mirrors_figure,
    views_figure,
)
from deepfsi.experiments.experiment import Experiment, Finding, Results
from deepfsi.hardware.calibration import fit as calibration
from deepfsi.hardware.patterns.folder import export_patterns
from deepfsi.hardware.patterns.gates import find_gates
from deepfsi.hardware.patterns.mirrors import make_frames, recount, unpack
from deepfsi.hardware.patterns.sequence import Grid, Patterns, find_device, find_grid
from deepfsi.hardware.recording import acquisition
from deepfsi.hardware.virtual import detector
from deepfsi.hardware.virtual.camera import CAMERAS, Camera, draw_counts, rates, record
from deepfsi.report.figures import photons_text
from deepfsi.report.study_page import Claim, Picture, Table
from deepfsi.statistics.bootstrap import (
    cluster_bootstrap,
    studentised_bootstrap,
    wilcoxon_signed_rank,
)
from deepfsi.statistics.differences import Difference, above, of_trials
from deepfsi.sweeps.queue import Report
from deepfsi.sweeps.workers import cores, processes

FLUX = 1e7
EXPOSURES = (1e-1, 1e-2, 1e-3, 1e-4)
ASSUMED = 1e4
SWEPT = (1e-2, 1e-3)
DRAWS, REPEATS = 20, 10
DEVICE = find_device("dlp7000")
FREE = "deepfsi-free-dwell"

LAB = CAMERAS["pmt"].model_copy(
    update={
        "efficiency": 1.0,
        "view": ((0.95, 0.03, 0.01), (-0.02, 0.94, 0.035), (0.015, -0.02, 1.0)),
        "blur": 8.0,
        "vignetting": 0.2,
    }
)
"""The laboratory: a photomultiplier behind a tilted, slightly blurred view of the display.

Its efficiency is 1, so that fluxes and budgets are of photons that can be counted.
"""

EFFECTS: dict[str, tuple[float, ...]] = {
    "ambient": (0.0, 1e5, 3e5, 1e6, 3e6, 1e7),
    "dark": (0.0, 1e4, 1e5, 3e5, 1e6),
    "dead_time_s": (0.0, 20e-9, 50e-9, 100e-9, 200e-9),
}
"""What is varied, one at a time: photons/s on the device, counts/s, seconds."""

AXES = {
    "ambient": "ambient light (photons/s on the device)",
    "dark": "dark counts (1/s)",
    "dead_time_s": "dead time (s)",
    "assumed": "budget assumed in training (photons)",
}

PAPER = (
    "With 92 masks (1024 for RS and HB) trained for one assumed budget, DeepFSI clearly "
    "outperforms the other designs in all digits when there are photons enough, and varies less "
    "between digits. The tests are of ten digits, each exposed ten times or more."
)

PUBLISHED: dict[str, dict[float, tuple[float, float, float]]] = {
    "deepfsi": {
        1e-1: (0.970, 0.940, 1.000), 1e-2: (0.860, 0.720, 0.960),
        1e-3: (0.670, 0.520, 0.810), 1e-4: (0.327, 0.258, 0.405),
    },
    "pca": {
        1e-1: (0.610, 0.420, 0.800), 1e-2: (0.430, 0.300, 0.560),
        1e-3: (0.270, 0.150, 0.410), 1e-4: (0.160, 0.117, 0.213),
    },
    "truncated-hadamard": {
        1e-1: (0.550, 0.350, 0.740), 1e-2: (0.370, 0.200, 0.560),
        1e-3: (0.400, 0.260, 0.540), 1e-4: (0.310, 0.190, 0.430),
    },
    "raster": {
        1e-1: (0.280, 0.000, 0.560), 1e-2: (0.210, 0.030, 0.420),
        1e-3: (0.140, 0.050, 0.260), 1e-4: (0.107, 0.057, 0.168),
    },
    "hadamard": {
        1e-1: (0.250, 0.090, 0.440), 1e-2: (0.250, 0.080, 0.440),
        1e-3: (0.230, 0.110, 0.360), 1e-4: (0.130, 0.010, 0.300),
    },
}  # fmt: skip
"""Mean and cluster-bootstrap interval, the paper's first table of its hardware experiment."""

STUDENTISED: dict[str, dict[float, tuple[float, float]]] = {
    "deepfsi": {
        1e-1: (0.939, 0.998), 1e-2: (0.515, 0.960), 1e-3: (0.477, 0.823), 1e-4: (0.253, 0.434),
    },
    "pca": {
        1e-1: (0.337, 0.830), 1e-2: (0.278, 0.597), 1e-3: (0.151, 0.509), 1e-4: (0.115, 0.291),
    },
    "truncated-hadamard": {
        1e-1: (0.295, 0.785), 1e-2: (0.192, 0.705), 1e-3: (0.252, 0.595), 1e-4: (0.156, 0.446),
    },
    "raster": {
        1e-1: (0.018, 0.582), 1e-2: (0.027, 0.725), 1e-3: (0.041, 0.358), 1e-4: (0.054, 0.233),
    },
    "hadamard": {
        1e-1: (0.088, 0.737), 1e-2: (0.055, 0.559), 1e-3: (0.091, 0.402), 1e-4: (0.012, 0.793),
    },
}  # fmt: skip
"""Its second table, studentised bootstrap."""

WILCOXON: dict[str, dict[float, tuple[float, float, float]]] = {
    "pca": {
        1e-1: (1.0, 0.017, 0.944), 1e-2: (0.0, 0.002, 1.0),
        1e-3: (3.0, 0.010, 0.891), 1e-4: (2.0, 0.006, 0.927),
    },
    "truncated-hadamard": {
        1e-1: (0.0, 0.012, 1.0), 1e-2: (0.0, 0.012, 1.0),
        1e-3: (5.5, 0.027, 0.800), 1e-4: (24.0, 0.770, 0.127),
    },
    "raster": {
        1e-1: (1.5, 0.010, 0.933), 1e-2: (1.0, 0.004, 0.964),
        1e-3: (0.0, 0.008, 1.0), 1e-4: (0.0, 0.002, 1.0),
    },
    "hadamard": {
        1e-1: (0.0, 0.002, 1.0), 1e-2: (0.0, 0.002, 1.0),
        1e-3: (2.5, 0.010, 0.909), 1e-4: (9.0, 0.064, 0.673),
    },
}  # fmt: skip
"""Its third table: statistic, p and rank-biserial against DeepFSI."""

PAPER_RUN_S = {"deepfsi": 1.0, "pca": 1.0, "hadamard": 144.0, "truncated-hadamard": 144.0}
"""Seconds for one run, photon file to class: about 1 s, and 4 hours for 100 runs."""


@lru_cache(maxsize=1)
def calibrate() -> calibration.Calibration:
    """Calibrate the laboratory with spots, a white and a black display, as a lab would."""
    grid = find_grid(DEVICE, (32, 32))
    spots = calibration.spot_scenes((32, 32))
    scenes = np.concatenate([spots, np.ones((1, 32, 32)), np.zeros((1, 32, 32))])
    exposure = 10.0
    rails = np.eye(grid.down * grid.across)[None] / (grid.down * grid.across)
    with tempfile.TemporaryDirectory() as folder:
        patterns = export_patterns(
            rails,
            "equal-dwell",
            (32, 32),
            DEVICE,
            1.1 * exposure / rails.shape[1],
            Path(folder) / "raster",
            summed_reflectance=float(grid.down * grid.across),
        )
        flow = rates(Path(folder) / "raster", scenes, LAB, FLUX)
    rng = np.random.default_rng(1)
    gates = find_gates(patterns.manifest, exposure, repeats=1)
    counts = draw_counts(flow, patterns.manifest, gates, LAB, rng)
    pictures = counts[:, 0, 0].reshape(len(scenes), 32, 32)
    black = flow[-1, :2, 0]
    dark, ambient = calibration.black_rates(black[:1], black[1:])
    return calibration.calibrate(
        spots, pictures[:-2], grid, white=pictures[-2], black=pictures[-1],
        dark=dark, ambient=ambient,
    )  # fmt: skip


def prepare(data: Dataset) -> Dataset:
    """The camera's view of a data set."""
    return calibration.view_dataset(data, calibrate())


@dataclass(frozen=True)
class Shown:
    """A design on the device.

    Attributes
    ----------
    design : Design
        As the patterns realise it.
    patterns : Patterns
    light : array, shape (S, F, 1)
        Photons/s that each scene sends to the detector in each frame.
    glow : array, shape (1, F, 1)
        The same for one photon/s of ambient light.
    """

    design: Design
    patterns: Patterns
    light: np.ndarray
    glow: np.ndarray

    def flow(self, camera: Camera) -> np.ndarray:
        """Arrivals/s (S, F, 1) at a camera's detector."""
        return camera.efficiency * (self.light + camera.ambient * self.glow) + camera.dark


def draw_digits(labels: np.ndarray, draws: int, seed: int) -> np.ndarray:
    """Places (draws, classes) of one scene of each class, no scene twice."""
    rng = np.random.default_rng(seed)
    classes = np.unique(labels)
    columns = [rng.choice(np.flatnonzero(labels == k), draws, replace=False) for k in classes]
    return np.stack(columns, axis=1)


def show_design(design: Design, scenes: np.ndarray) -> Shown:
    """Export a design and let the optics of the laboratory look at scenes (S, h, w) through it."""
    optics = LAB.model_copy(update={"dark": 0.0, "ambient": 0.0})
    with tempfile.TemporaryDirectory() as folder:
        there = Path(folder) / "patterns"
        patterns = _export(design, REPEATS, there)
        light = rates(there, scenes, optics, FLUX)
        one = optics.model_copy(update={"ambient": 1.0})
        glow = rates(there, np.zeros_like(scenes[:1]), one, 0.0)
    return Shown(design.as_shown(*patterns.realised), patterns, light, glow)


def _export(design: Design, repeats: int, folder: Path) -> Patterns:
    """Patterns whose frames last for so many of the longest exposures, and a little more."""
    rails = design.rails.numpy()
    frames = int((rails.max(axis=-1) > 0).sum())
    share = float(rails.max()) if design.light == "equal-dwell" else 1 / frames
    return export_patterns(
        rails,
        design.light,
        design.image_shape,
        DEVICE,
        1.01 * repeats * max(EXPOSURES) * share + DEVICE.settle_us * 1e-6,
        folder,
        summed_reflectance=design.summed_reflectance,
    )


def classify(
    shown: Shown, camera: Camera, exposure_s: float, rng: np.random.Generator
) -> np.ndarray:
    """Classes (S, R) that a design gives to exposures of a camera.

    The budget is estimated from the all-ON frames and the dark rate from the all-OFF ones, as for
    a real run; no one knows of ambient light.
    """
    manifest = shown.patterns.manifest
    gates = find_gates(manifest, exposure_s, repeats=REPEATS)
    flow = shown.flow(camera)
    counts = draw_counts(flow, manifest, gates, camera, rng)
    window = manifest.picture_s[:2] - gates.settle_s
    on, off = (detector.draw(camera, flow[:, :2, 0], window, rng) / window).mean(axis=0)
    signal = calibration.subtract_background(counts, shown.patterns, exposure_s, off)
    chances = shown.design.classify(shown.design.readouts(signal), (on - off) * exposure_s)
    return chances.argmax(axis=-1)


def measure(
    results: Results, data: Dataset, designs: Path, workers: int | None, report: Report
) -> dict[str, Any]:
    """Test every design in the laboratory, several at a time."""
    raw = load_dataset(results["recipe"]["data"])
    places = draw_digits(raw.y_test, DRAWS, seed=0)
    laboratory = Laboratory(
        designs, raw.x_test[places.ravel()].reshape(-1, *raw.image_shape), raw.y_test[places]
    )
    groups: dict[str, list[dict[str, Any]]] = {}
    for point in results["points"]:
        if point["best"]:
            name = point["design"] if point["light"] == "equal-dwell" else FREE
            groups.setdefault(name, []).append(point)
    costly_first = sorted(groups.items(), key=lambda group: -group[1][0]["masks"])
    tests, times, frame = [], [], ""
    report(0.0, "laboratory")
    done = processes(in_laboratory, laboratory, costly_first, min(workers or cores(), len(groups)))
    for number, result in enumerate(done, start=1):
        report(number / len(groups), "laboratory")
        tests += result["tests"]
        times.append(result["time"])
        frame = frame or result["frame"]
    order = list(groups)
    tests.sort(key=lambda test: order.index(test["design"]))
    times.sort(key=lambda each: order.index(each["design"]))
    seen = data.x_test[places[0]].reshape(-1, *data.image_shape)
    return {
        "calibration": calibrate().model_dump(mode="json", exclude={"flat"}),
        "camera": LAB.model_dump(mode="json"),
        "views": {
            "raw": laboratory.images[: len(seen)].round(3).tolist(),
            "seen": seen.round(3).tolist(),
            "names": list(data.classes),
        },
        "frame": frame,
        "tests": tests,
        "times": times,
    }


@dataclass(frozen=True)
class Laboratory:
    """What every design is tested on.

    Attributes
    ----------
    designs : Path
        Folder of their files.
    images : array, shape (S, h, w)
        Reflectance on the display.
    truth : array, shape (draws, classes)
        Labels; S is their number.
    """

    designs: Path
    images: np.ndarray
    truth: np.ndarray


def in_laboratory(
    laboratory: Laboratory, group: tuple[str, list[dict[str, Any]]]
) -> dict[str, Any]:
    """Test one design, trained for several budgets."""
    name, points = group
    label = "DeepFSI, free dwell" if name == FREE else points[0]["label"]
    result: dict[str, Any] = {"tests": [], "frame": ""}
    looks: dict[bytes, Shown] = {}
    for point in points:
        file = laboratory.designs / f"{point['keys'][0]}.safetensors"
        design = Design.load(file)
        rails = design.rails.numpy().tobytes()  # the same for every budget where masks are fixed
        if rails not in looks:
            looks[rails] = show_design(design, laboratory.images)
        shown = replace(looks[rails], design=design.as_shown(*looks[rails].patterns.realised))
        for effect, value, camera, exposures in _settings(point["photons"]):
            for exposure in exposures:
                rng = np.random.default_rng([0, len(result["tests"])])
                classes = classify(shown, camera, exposure, rng)
                right = classes.reshape(*laboratory.truth.shape, REPEATS)
                right = right == laboratory.truth[..., None]
                result["tests"].append(
                    {
                        "design": name,
                        "label": label,
                        "specific": point["specific"],
                        "masks": point["masks"],
                        "assumed": point["photons"],
                        "effect": effect,
                        "value": value,
                        "exposure_s": exposure,
                        "rates": right.mean(axis=-1).tolist(),
                    }
                )
        if point["photons"] == ASSUMED:
            result["time"] = {
                "design": name, "label": label, **run_time(design, laboratory.images[:1])
            }  # fmt: skip
            if name == "deepfsi":
                result["frame"] = base64.b64encode(_first_frame(shown.patterns).tobytes()).decode()
    return result


def _settings(assumed: float) -> Iterable[tuple[str, float, Camera, Sequence[float]]]:
    """What is varied, its value, the camera and the exposures; effects at our own budget only."""
    yield "none", 0.0, LAB, EXPOSURES
    if assumed == ASSUMED:
        for effect, values in EFFECTS.items():
            for value in values:
                yield effect, value, LAB.model_copy(update={effect: value}), SWEPT


def run_time(design: Design, scene: np.ndarray) -> dict[str, Any]:
    """Seconds from a photon file to its classes, for one exposure of the longest time."""
    with tempfile.TemporaryDirectory() as folder:
        patterns, run = Path(folder) / "patterns", Path(folder) / "run"
        _export(design, 1, patterns)
        record(
            patterns, scene, ["scene"], None, run,
            camera=LAB, flux=FLUX, exposure_s=max(EXPOSURES), repeats=1, seed=0,
        )  # fmt: skip
        began = time.perf_counter()
        counts = acquisition.count(run)
        shown = design.as_shown(*acquisition.read_acquisition(run)[1].realised)
        shown.classify(shown.readouts(counts.signal()), counts.photons)
        seconds = time.perf_counter() - began
        return {
            "seconds": seconds,
            "photons": int(counts.counts.sum()),
            "bytes": (run / "photons.ptu").stat().st_size,
        }


def _first_frame(patterns: Patterns) -> np.ndarray:
    manifest = patterns.manifest
    return next(iter(make_frames(patterns.on[:1], manifest.device, manifest.grid)))


def show(results: Results) -> Finding:
    """Figures, claims and tables of the laboratory."""
    extra = results["extra"]
    at = {
        (test["design"], test["exposure_s"]): test
        for test in extra["tests"]
        if test["effect"] == "none" and test["assumed"] == ASSUMED
    }
    names = list(dict.fromkeys(design for design, _ in at))
    labels = {design: test["label"] for (design, _), test in at.items()}
    rivals = [name for name in names if name not in ("deepfsi", FREE)]
    points = [_point(test) for test in at.values()]
    first = {
        exposure: {rival: _less(at, "deepfsi", rival, exposure) for rival in rivals}
        for exposure in EXPOSURES
    }
    bright = [exposure for exposure in EXPOSURES if exposure >= 1e-3]
    free = [_less(at, FREE, "deepfsi", exposure) for exposure in EXPOSURES]
    order = sorted(
        (point for point in points if point["exposure_s"] == 1e-2), key=lambda p: -p["accuracy"]
    )
    found = (
        f"Trained for {photons_text(ASSUMED)} photons and tested over 0.01 s "
        f"({photons_text(FLUX * 1e-2)} photons): "
        + ", ".join(f"{p['label']} {p['accuracy']:.3f}" for p in order)
        + f". Means over {DRAWS} draws of ten digits, {REPEATS} exposures each; intervals are "
        "Student's over draws, for one trained design each. Non-negative masks with times of "
        f"their own differ from signed masks of equal times by {free[0]} at 0.1 s and {free[-1]} "
        "at 0.0001 s."
    )
    frame = np.frombuffer(base64.b64decode(extra["frame"]), np.uint8).reshape(DEVICE.rows, -1)
    mirrors = unpack(frame, DEVICE)
    views = extra["views"]
    grid = find_grid(DEVICE, tuple(results["data"]["image_shape"]))
    fit = extra["calibration"]
    pictures = (
        Picture(
            exposure_figure(points, _published(rivals), flux=FLUX),
            "Accuracy of ten digits against exposure. Filled: here, mean over draws with its 95 % "
            "interval. Open: published, of one draw, with its interval over the ten digits.",
            "Accuracy against exposure for each design, beside the published values; see tables.",
        ),
        Picture(
            digits_figure(
                {
                    f"{exposure:g} s": np.array(
                        [np.mean(at[(name, exposure)]["rates"], axis=0) for name in names]
                    )
                    for exposure in EXPOSURES
                },
                [labels[name] for name in names],
                results["data"]["classes"],
            ),
            "Success rate of each digit, mean over draws.",
            "Success rate of each digit and design for four exposures.",
        ),
        Picture(
            effects_figure(_swept(extra["tests"]), AXES, flux=FLUX),
            "What the laboratory could not vary, one effect at a time; no one corrects for "
            "ambient light or dead time. Top: 0.01 s, bottom: 0.001 s.",
            "Accuracy against ambient light, dark counts, dead time and assumed budget.",
        ),
        Picture(
            views_figure(
                np.array(views["raw"]),
                np.array(views["seen"]),
                views["names"],
                cell=(grid.height, grid.width),
            ),
            "Digits as displayed and as the camera's cells see them. The view was fitted to "
            f"{fit['spots']} of {fit['shown']} spots, which lie {fit['residual']:.2f} cells from "
            "it (rms).",
            "Ten digits above, and below them tilted, blurred and darker at the edges.",
        ),
        Picture(
            mirrors_figure(mirrors, grid, _greyest(mirrors, grid)),
            "DeepFSI's first frame, and its nine cells with most grey mirror by mirror.",
            "A grey mask made of mirrors that are ON or OFF.",
        ),
    )
    worst = {
        rival: min((each for row in first.items() if row[0] in bright
                    for name, each in row[1].items() if name == rival), key=lambda d: d.low)
        for rival in rivals
    }  # fmt: skip
    nearest = min(worst, key=lambda rival: worst[rival].low)
    claims = (
        Claim(
            "DeepFSI is first of the equal-dwell designs at every exposure from 0.001 s up",
            above(each for exposure in bright for each in first[exposure].values()),
            f"nearest: {labels[nearest]}, {worst[nearest]}",
        ),
        _every_digit(at, rivals, labels),
        _even(at, rivals, labels),
    )
    tables = (
        _intervals(at, names, labels),
        _tests(at, rivals, labels),
        _times(extra["times"]),
    )
    return Finding(found, pictures, claims, tables)


def _greyest(mirrors: np.ndarray, grid: Grid, side: int = 3) -> tuple[int, int]:
    """First cell of the window of side x side cells that are farthest from dark and full."""
    share = recount(mirrors, grid).reshape(grid.down, grid.across) / grid.mirrors
    grey = np.minimum(share, 1 - share)
    windows = np.lib.stride_tricks.sliding_window_view(grey, (side, side)).sum(axis=(2, 3))
    down, across = np.unravel_index(windows.argmax(), windows.shape)
    return int(down), int(across)


def _point(test: dict[str, Any]) -> dict[str, Any]:
    mean = of_trials(np.mean(test["rates"], axis=1).tolist())
    return {
        **{key: test[key] for key in test if key != "rates"},
        "accuracy": mean.mean,
        "low": max(mean.low, 0.0),
        "high": min(mean.high, 1.0),
    }


def _less(at: dict[tuple[str, float], Any], one: str, other: str, exposure: float) -> Difference:
    """Accuracy of one design less another's on the same digits, with its error over draws."""
    rates_of = [np.mean(at[(name, exposure)]["rates"], axis=1) for name in (one, other)]
    return of_trials((rates_of[0] - rates_of[1]).tolist())


def _published(rivals: Sequence[str]) -> list[dict[str, Any]]:
    return [
        {"design": name, "exposure_s": exposure, "accuracy": mean, "low": low, "high": high}
        for name in ("deepfsi", *rivals)
        for exposure, (mean, low, high) in PUBLISHED[name].items()
    ]


def _swept(tests: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Points of the sweeps at the two exposures that are drawn."""
    swept = []
    for test in tests:
        if test["exposure_s"] not in SWEPT:
            continue
        point = _point(test)
        if test["effect"] == "none":
            point |= {"effect": "assumed", "value": test["assumed"]}
        swept.append(point)
    return swept


def _every_digit(
    at: dict[tuple[str, float], Any], rivals: Sequence[str], labels: dict[str, str]
) -> Claim:
    exposure = max(EXPOSURES)
    behind = []
    differences = []
    for rival in rivals:
        one, other = (np.array(at[(name, exposure)]["rates"]) for name in ("deepfsi", rival))
        for digit, column in enumerate((one - other).T):
            each = of_trials(column.tolist())
            differences.append(each)
            if each.mean <= 0:
                behind.append(f"{digit} ({labels[rival]})")
    least = min(differences, key=lambda each: each.mean)
    said = f"lowest {least}" + (f"; not above in {', '.join(behind)}" if behind else "")
    return Claim(
        f"DeepFSI is above every other equal-dwell design in every digit at {exposure:g} s",
        above(differences),
        said,
    )


def _even(at: dict[tuple[str, float], Any], rivals: Sequence[str], labels: dict[str, str]) -> Claim:
    exposure = max(EXPOSURES)
    spread = {
        name: np.std(at[(name, exposure)]["rates"], axis=1, ddof=1) for name in ("deepfsi", *rivals)
    }
    less = {rival: of_trials((spread[rival] - spread["deepfsi"]).tolist()) for rival in rivals}
    nearest = min(less, key=lambda rival: less[rival].low)
    return Claim(
        f"DeepFSI varies least between digits at {exposure:g} s",
        above(less.values()),
        f"standard deviation over digits lower by {less[nearest]} than {labels[nearest]}'s",
    )


def _intervals(
    at: dict[tuple[str, float], Any], names: Sequence[str], labels: dict[str, str]
) -> Table:
    rows = []
    for exposure in EXPOSURES:
        for name in names:
            draws = np.array(at[(name, exposure)]["rates"])
            mean = of_trials(draws.mean(axis=1).tolist())
            cluster = np.mean([cluster_bootstrap(rate, seed=0) for rate in draws], axis=0)
            student = np.mean([studentised_bootstrap(rate, seed=0) for rate in draws], axis=0)
            published = PUBLISHED.get(name, {}).get(exposure)
            rows.append(
                (
                    exposure,
                    labels[name],
                    mean.mean,
                    f"{mean.low:.3f} to {mean.high:.3f}",
                    f"{cluster[0]:.3f} to {cluster[1]:.3f}",
                    f"{student[0]:.3f} to {student[1]:.3f}",
                    published[0] if published else None,
                    f"{published[1]:.3f} to {published[2]:.3f}" if published else "",
                    "{:.3f} to {:.3f}".format(*STUDENTISED[name][exposure]) if published else "",
                )
            )
    return Table(
        "Accuracy with 95 % intervals: over draws of the digits, and, for one draw, over its ten "
        "digits by cluster and by studentised bootstrap (mean ends over draws), beside the paper's",
        ("exposure (s)", "design", "accuracy", "over draws", "cluster", "studentised",
         "paper", "paper, cluster", "paper, studentised"),
        tuple(rows),
    )  # fmt: skip


def _tests(
    at: dict[tuple[str, float], Any], rivals: Sequence[str], labels: dict[str, str]
) -> Table:
    rows = []
    for exposure in EXPOSURES:
        ours = np.array(at[("deepfsi", exposure)]["rates"])
        for rival in rivals:
            tests = [
                wilcoxon_signed_rank(one, other)
                for one, other in zip(ours, at[(rival, exposure)]["rates"], strict=True)
            ]
            statistic, p, effect = np.median(tests, axis=0)
            clear = float(np.mean([test.pvalue < 0.05 for test in tests]))
            published = WILCOXON[rival][exposure]
            rows.append((exposure, labels[rival], statistic, p, effect, clear, *published))
    return Table(
        "Two-sided Wilcoxon signed-rank test against DeepFSI over the ten digits: medians over "
        "draws, the share of draws with p below 0.05, and the paper's",
        ("exposure (s)", "design", "statistic", "p", "rank-biserial", "draws below 0.05",
         "paper: statistic", "paper: p", "paper: rank-biserial"),
        tuple(rows),
    )  # fmt: skip


def _times(times: Sequence[dict[str, Any]]) -> Table:
    rows = tuple(
        (each["label"], each["photons"], each["bytes"] / 1e6, each["seconds"],
         PAPER_RUN_S.get(each["design"]))
        for each in times
    )  # fmt: skip
    return Table(
        f"From photon file to class, one exposure of {max(EXPOSURES):g} s",
        ("design", "photons counted", "file (MB)", "seconds", "paper (s)"),
        rows,
    )


EXPERIMENT = Experiment(
    name="hardware",
    title="The camera: designs on a micromirror device, read by one photon counter",
    paper=PAPER,
    show=show,
    measure=measure,
    prepare=prepare,
    also=("hardware-free",),
)
