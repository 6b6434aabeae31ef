"""Options of the commands, their values parsed, and the job or recipe that they ask for."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.cli import common
from deepfsi.errors import InputError, check_known

if TYPE_CHECKING:
    import numpy as np

    from deepfsi.datasets import Dataset
    from deepfsi.hardware.recording.dead_time import DeadTime as CounterDeadTime
    from deepfsi.optics.detection import Detection

MOST_PIXELS = 10_000
"""Pixels of a side of an image."""

Data = Annotated[
    str,
    typer.Option(
        "--data", help="name (deepfsi data list), folder or .zip of images, cube, or .npz"
    ),
]
TestData = Annotated[
    str | None,
    typer.Option("--data", help="name or path, as for `design`; the design's own unless given"),
]
Size = Annotated[
    str | None, typer.Option(help="resize images to HEIGHTxWIDTH, or one number for both")
]
View = Annotated[
    Path | None,
    typer.Option(
        help="folder of a camera's calibration: train on the scenes as this camera sees them"
    ),
]
Device = Annotated[str, typer.Option(help="auto, cpu or cuda")]
Workers = Annotated[
    int | None, typer.Option(min=1, help="processes; one for each core unless given")
]
Ray = Annotated[str | None, typer.Option(help="work on a Ray cluster: its address, or auto")]
Json = Annotated[bool, typer.Option("--json", help="print JSON and nothing else")]
Folder = Annotated[Path, typer.Option("--out", "-o", help="output folder")]
Matrix = Annotated[
    str | None,
    typer.Option(
        help="your own masks: .npy or .mat (FILE.mat:VARIABLE) of shape (m, N) or (m, H, W), a "
        "folder of images, or a TIFF of m pages"
    ),
]
Balance = Annotated[
    bool,
    typer.Option("--balance", help="weight the training scenes so that all classes count equally"),
]
Epochs = Annotated[int | None, typer.Option(help="training epochs")]
TrainNoise = Annotated[
    str | None,
    typer.Option(help="noise in training, if different: ml_gauss, poisson, gaussian, camera, none"),
]

# one design

PhotonRange = Annotated[
    str | None,
    typer.Option(
        help="budget: expected photons on the coding device; LOW:HIGH for a range of budgets"
    ),
]
Counts = Annotated[
    str | None,
    typer.Option(
        help="instead of --photons: expected number of detected photons, averaged over the scenes"
    ),
]
DesignFile = Annotated[Path, typer.Option("--out", "-o", help="design file, .safetensors")]
MaskCount = Annotated[str | None, typer.Option(help="number of masks, m")]
Design = Annotated[str | None, typer.Option("--design", help="which design; deepfsi unless given")]
Noise = Annotated[
    str,
    typer.Option(
        help="poisson, gaussian, camera (photons, dark counts and read noise), none, or "
        "module:function of your own"
    ),
]
Sigma = Annotated[
    float, typer.Option(help="read noise of gaussian and camera noise, counts rms per readout")
]
Dark = Annotated[
    float, typer.Option(help="dark counts of a detector in a whole exposure, for camera noise")
]
Light = Annotated[
    str, typer.Option(help="light law of the optics: column, equal-dwell, free-dwell or two-arm")
]
Rails = Annotated[
    str, typer.Option(help="dual: signed masks of two frames each; single: non-negative masks")
]
Detectors = Annotated[
    str,
    typer.Option(
        help="detectors, each on its part of the device: ROWSxCOLUMNS, a number of spectral "
        "bands, or a .npy map with each pixel's detector, from 0"
    ),
]
Readout = Annotated[
    str | None,
    typer.Option(
        help="what the network reads of two rails: both, or their difference; by default both "
        "for two-arm, else the difference"
    ),
]
Nested = Annotated[
    int,
    typer.Option(
        help="nested masks: smallest number of first masks from which the network must "
        "classify; 0: always all"
    ),
]
Levels = Annotated[
    int,
    typer.Option(
        help="grey levels of the masks, dark included: 2 for ON and OFF; 0 for continuous values"
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        help="design that learned masks start from; pca unless given, class-pairs for several looks"
    ),
]
Looks = Annotated[
    int,
    typer.Option(
        help="parts (looks) of an exposure: the counts so far choose the dwells of the next part"
    ),
]
ShortestDwell = Annotated[
    str | None,
    typer.Option(
        help="shortest time for which a frame is counted, such as 32us: the device's shortest "
        "picture less settling and 2 us; needs --exposure"
    ),
]
DesignExposure = Annotated[
    str | None, typer.Option(help="time of a whole exposure, such as 10ms; for --shortest-dwell")
]
Classifier = Annotated[
    str, typer.Option(help="mlp, or module:factory of a torch module of your own")
]
Trust = Annotated[
    bool, typer.Option("--trust", help="run the code of the classifier that the design names")
]
Draws = Annotated[int, typer.Option(help="noise draws of each scene")]
NoiseSeed = Annotated[int, typer.Option(help="seed of the noise")]

# many designs

Designs = Annotated[str | None, typer.Option(help="names, separated by commas")]
MaskCounts = Annotated[str | None, typer.Option(help="mask counts, instead of ratios")]
Noises = Annotated[
    str | None, typer.Option(help="poisson, gaussian, camera, none, or module:function")
]
Sigmas = Annotated[
    float | None, typer.Option(help="read noise, gaussian and camera, counts rms per readout")
]
Darks = Annotated[
    float | None, typer.Option(help="dark counts of a detector in an exposure, camera noise")
]
Lights = Annotated[str | None, typer.Option(help="light laws, such as column,free-dwell")]
RailsAxis = Annotated[str | None, typer.Option(help="dual, single")]
DetectorsAxis = Annotated[
    str | None, typer.Option(help="detectors, each on its part of the device: 1x1,2x2,map.npy")
]
ReadoutAxis = Annotated[
    str | None, typer.Option(help="what the network reads of two rails: both, difference")
]
Trials = Annotated[int | None, typer.Option(help="training seeds for each point")]


# acquisitions

Exposure = Annotated[
    str | None,
    typer.Option(help="total exposure, such as 0.01 or 10ms; the recorded one unless given"),
]
Settle = Annotated[
    str | None,
    typer.Option(
        help="time for mirrors to settle in each frame; the device's, or the recorded one, unless "
        "given"
    ),
]
Repeats = Annotated[
    int | None,
    typer.Option(
        min=1, help="exposures in one pass; as many as fit, or were recorded, unless given"
    ),
]
Run = Annotated[Path, typer.Argument(help="acquisition folder, with photons.ptu in it")]
Inputs = Annotated[
    list[int] | None,
    typer.Option(
        "--input",
        help="input of the counter, 1 for the first, as `inspect` numbers them; one for each "
        "detector, on two arms first those that see mirrors ON",
    ),
]
Marker = Annotated[
    int | None,
    typer.Option(
        min=0, max=3, help="marker input of the trigger, 0 for the first, as `inspect` numbers them"
    ),
]


DeadTime = Annotated[
    str | None,
    typer.Option(
        help="correct for this dead time of the counter, such as 20ns; unless given `count` takes "
        "that of the folder's calibration, others none"
    ),
]
DeadTimeModel = Annotated[
    str | None,
    typer.Option(
        help="non-paralysable (a SPAD, a counter's electronics; the default), or paralysable (a "
        "photomultiplier)"
    ),
]


def dead_time(text: str | None, model: str | None) -> "CounterDeadTime | None":
    """Dead time of --dead-time and --dead-time-model, or None where none is given."""
    from deepfsi.hardware.recording.dead_time import LONGEST_S, DeadTime

    models = {"non-paralysable": False, "paralysable": True}
    if model is not None:
        check_known("--dead-time-model", model, models)
    if text is None:
        if model is not None:
            raise InputError("--dead-time-model is of a dead time: give --dead-time, such as 20ns")
        return None
    length = seconds("dead-time", text)
    if length > LONGEST_S:
        raise InputError(f"--dead-time {text} is not allowed: give up to {LONGEST_S * 1e6:g}us")
    return DeadTime(seconds=length, paralysable=models[model or "non-paralysable"])


def words(text: str | None) -> list[str] | None:
    """Parts of a text separated by commas."""
    return None if text is None else [part.strip() for part in text.split(",") if part.strip()]


def numbers(option: str, text: str | None, whole: bool = False) -> list[Any] | None:
    """Numbers of an option, separated by commas, or `InputError`; None where it is not given."""
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    if not all(parts):
        raise InputError(
            f"--{option} {text!r} has an empty place: give one number or more, separated by commas"
        )
    return [(whole_number if whole else number)(option, part) for part in parts]


def number(option: str, text: str) -> float:
    """Value of an option that is a number, or `InputError`."""
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"--{option} {text!r} is not a number") from None
    if not math.isfinite(value):
        raise InputError(f"--{option} {text!r} is not allowed: give a finite number")
    return value


def whole_number(option: str, text: str) -> int:
    """Value of an option that is a whole number, or `InputError`."""
    value = number(option, text)
    if not value.is_integer():
        raise InputError(f"--{option} {text!r} is not a whole number")
    return int(value)


def seconds(option: str, text: str) -> float:
    """Seconds of a time such as 0.01, 10ms or 44us, or `InputError`."""
    value = text.strip().lower()
    units = {"ps": 1e-12, "ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "": 1.0}
    unit = next(each for each in units if value.endswith(each))
    try:
        time = float(value.removesuffix(unit)) * units[unit]
    except ValueError:
        time = math.nan
    if not (math.isfinite(time) and time >= 0):
        raise InputError(f"--{option} {text!r} is not a time: give seconds, or such as 10ms, 44us")
    return time


def optional_seconds(option: str, text: str | None) -> float | None:
    """Seconds of a time, or None where none is given."""
    return None if text is None else seconds(option, text)


Scenes = Annotated[
    Path, typer.Option(help="image, or folder of images, with or without a folder for each class")
]
CameraSettings = Annotated[
    str, typer.Option("--camera", help="ideal, pmt, spad, or a TOML file of camera settings")
]
CameraSeed = Annotated[
    int,
    typer.Option(min=0, help="seed of the random numbers: the same one repeats the run exactly"),
]
LargeFile = Annotated[bool, typer.Option("--yes", help="write a large file without asking")]
Budget = Annotated[
    float | None,
    typer.Option(
        help="budget of an exposure in counts, detector efficiency included; that of the all-ON "
        "frames unless given"
    ),
]


def dwell_settings(shortest: str | None, exposure: str | None) -> dict[str, float]:
    """Settings of `learn` of the options --shortest-dwell and --exposure, or `InputError`."""
    if shortest is None and exposure is None:
        return {}
    if shortest is None or exposure is None:
        raise InputError(
            "the shortest dwell is told as a share of the exposure: give both --shortest-dwell and "
            "--exposure, or neither"
        )
    frame_s, exposure_s = seconds("shortest-dwell", shortest), seconds("exposure", exposure)
    if frame_s >= exposure_s:
        raise InputError(
            f"--shortest-dwell {shortest} is not below --exposure {exposure}: give a longer "
            "exposure, which has room for more than one frame"
        )
    return {"shortest_dwell": frame_s / exposure_s}


def wiring(inputs: list[int] | None, marker: int | None) -> dict[str, Any]:
    """Settings of an acquisition that say which inputs of the counter are used, as far as given."""
    from deepfsi.hardware.recording.acquisition import MOST_INPUTS

    for each in inputs or ():
        if not 1 <= each <= MOST_INPUTS:
            raise InputError(f"--input {each} is not allowed: give 1 to {MOST_INPUTS}")
    given = {
        "inputs": tuple(each - 1 for each in inputs) if inputs else None,
        "marker_bit": None if marker is None else 1 << marker,
    }
    return {name: value for name, value in given.items() if value is not None}


def size_of(text: str | None) -> tuple[int, int] | None:
    """Height and width of HEIGHTxWIDTH, or of one number for both."""
    if text is None:
        return None
    sides = text.lower().split("x")
    sound = all(side.isdecimal() and 0 < int(side) <= MOST_PIXELS for side in sides)
    if not sound or len(sides) > 2:
        raise InputError(
            f"--size {text!r} is not allowed: give HEIGHTxWIDTH, such as 32x32, of at most "
            f"{MOST_PIXELS} pixels each"
        )
    return int(sides[0]), int(sides[-1])


def budget_range(text: str) -> tuple[float, float]:
    """Lowest and highest budget of NUMBER or LOW:HIGH, or `InputError`."""
    parts = [number("photons", part) for part in text.split(":")]
    if len(parts) > 2 or not 0 < parts[0] <= parts[-1]:
        raise InputError(
            f"--photons {text!r} is not allowed: give a number above 0, or LOW:HIGH such as 1e3:1e6"
        )
    return parts[0], parts[-1]


def light_settings(photons: str | None, counts: str | None) -> dict[str, float]:
    """Settings of `learn` of one of the options --photons and --counts, or `InputError`."""
    from deepfsi.optics.budget import check_one_budget

    counted = None if counts is None else number("counts", counts)
    if photons is None:
        return {"counts": check_one_budget(None, counted, 1.0)}
    lowest, highest = budget_range(photons)
    return {"photons": check_one_budget(lowest, counted, 1.0), "span": highest / lowest}


def check_sigma(context: typer.Context, *noises: str | None) -> None:
    """Raise `InputError` if read noise is given and none of these noises has any."""
    if common.is_given(context, "sigma") and not {"gaussian", "camera"} & {*noises}:
        named = " and ".join(dict.fromkeys(filter(None, noises)))
        raise InputError(
            f"--sigma is not of {named} noise: leave it out, or give --noise gaussian or camera"
        )


def job_settings(
    options: Mapping[str, Any], data: "Dataset", matrix: "np.ndarray | None"
) -> dict[str, Any]:
    """Settings of `learn` that the options of `design` ask for, but for device, matrix and report.

    The options are by the names of their parameters. The data decides how many masks a design of a
    fixed number has; the matrix, (m, N), is the user's own.
    """
    from deepfsi.optics.detection import Detection, read_detectors
    from deepfsi.sweeps.recipe import training_noise

    usual = training_noise(options["noise"])
    if options["looks"] > 1 and usual == "ml_gauss":
        usual = "poisson"  # a look shows many masks too shortly for MLGauss
    labels = read_detectors(options["detectors"])
    detection = Detection.of(labels, data.image_shape)
    design, masks = _design_and_masks(options["name"], options["masks"], data, matrix, detection)
    trained = options["train_noise"] or usual
    same = (
        *("sigma", "light", "rails", "readout", "seed", "nested", "levels", "looks", "epochs"),
        *("start", "classifier", "balance"),
    )
    settings = {name: options[name] for name in same if options[name] is not None}
    return settings | {
        "design": design,
        "masks": masks,
        "detectors": labels,
        **light_settings(options["photons"], options["counts"]),
        **dwell_settings(options["shortest_dwell"], options["exposure"]),
        "noise": trained,
        "dark": options["dark"] if trained == "camera" else 0.0,
    }


def _design_and_masks(
    name: str | None,
    masks: str | None,
    data: "Dataset",
    matrix: "np.ndarray | None",
    detection: "Detection",
) -> tuple[str, int]:
    from deepfsi.optics import codes, tiles

    if matrix is not None:
        if masks is not None or name not in (None, "custom"):
            raise InputError(
                "--matrix is a design with its own masks: leave --masks and --design out"
            )
        return "custom", len(matrix)
    design = codes.check_design(name or "deepfsi")
    if masks is not None:
        return design, whole_number("masks", masks)
    if not codes.DESIGNS[design].fixed_count:
        raise InputError(f"{design} needs a number of masks: add --masks, for instance --masks 10")
    seen = (detection,) if design != "impulse" else ()
    return design, tiles.count_allowed(design, data, *seen)[1]


def recipe_settings(options: Mapping[str, Any], base: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of the recipe that the options of `compare` or `plan` ask for.

    The options are by the names of their parameters, None where one is not given; settings of
    `base` hold where no option overrides them.
    """
    if options["masks"] is not None and options["ratios"] is not None:
        raise InputError("--masks and --ratios are two ways to say one thing: give one, not both")
    axes = ("designs", "noise", "train_noise", "light", "rails", "detectors", "readout")
    given = {name: words(options.get(name)) for name in axes} | {
        "data": options["data"],
        "size": size_of(options["size"]),
        "photons": numbers("photons", options["photons"]),
        "ratios": numbers("ratios", options["ratios"]),
        "masks": numbers("masks", options["masks"], whole=True),
        "sigma": options["sigma"],
        "dark": options.get("dark"),
        "trials": options["trials"],
    }
    given = {name: value for name, value in given.items() if value is not None}
    replaced = {"masks": "ratios", "ratios": "masks"}
    left_out = {replaced[name] for name in given if name in replaced}
    settings = {name: value for name, value in base.items() if name not in left_out} | given
    told = {"epochs": options["epochs"], "balance": options.get("balance") or None}
    told = {name: value for name, value in told.items() if value is not None}
    if told and isinstance(settings.setdefault("training", {}), dict):
        settings["training"] = {**settings["training"], **told}
    if told and isinstance(tuned := settings.get("tuned"), dict):
        settings["tuned"] = {
            design: {name: value for name, value in table.items() if name not in told}
            if isinstance(table, dict)
            else table
            for design, table in tuned.items()
        }
    return settings
