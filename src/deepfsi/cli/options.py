"""Options of the commands, their values parsed, and the job or recipe that they ask for."""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.base import InputError, join_messages
from deepfsi.cli.settings import values

if TYPE_CHECKING:
    import numpy as np

    from deepfsi.datasets import Dataset
    from deepfsi.jobs import Job

MOST_PIXELS = 10_000
"""Pixels of a side of an image."""

Data = Annotated[
    str,
    typer.Option(
        "--data",
        help="name (deepfsi data list), folder or .zip of images, .csv of file names and labels "
        "or values, cube, or .npz",
    ),
]
TestData = Annotated[
    str | None,
    typer.Option("--data", help="name or path, as for `design`; the design's own unless given"),
]
Size = Annotated[
    str | None, typer.Option(help="resize images to HEIGHTxWIDTH, or one number for both")
]
SkipBad = Annotated[
    bool, typer.Option("--skip-bad", help="leave pictures that cannot be read out, and name them")
]
Normal = Annotated[
    str | None,
    typer.Option(help="class to be told from anomalies; these are made from its own scenes"),
]
View = Annotated[
    Path | None,
    typer.Option(help="folder of a camera's calibration: take the scenes as this camera sees them"),
]
Device = Annotated[
    str, typer.Option(help="auto, cpu, cuda, one of several GPUs such as cuda:1, or mps")
]
Workers = Annotated[
    int | None, typer.Option(min=1, help="processes; one for each core unless given")
]
Ray = Annotated[str | None, typer.Option(help="work on a Ray cluster: its address, or auto")]
Force = Annotated[bool, typer.Option("--force", help="replace what is at --out")]
Json = Annotated[bool, typer.Option("--json", help="print JSON and nothing else")]
Folder = Annotated[Path, typer.Option("--out", "-o", help="output folder")]
Matrix = Annotated[
    str | None,
    typer.Option(
        help="your own masks: .npy or .mat (FILE.mat:VARIABLE) of shape (m, N) or (m, H, W), a "
        "folder of images, or a TIFF of m pages"
    ),
]

# one design

DesignFile = Annotated[Path, typer.Option("--out", "-o", help="design file, .safetensors")]
Noise = Annotated[
    str | None, typer.Option(help="noise of the tests; that of the design's camera unless given")
]
Sigma = Annotated[
    float | None,
    typer.Option(help="read noise of gaussian and camera noise, counts rms per readout"),
]
Dark = Annotated[
    float | None,
    typer.Option(help="dark counts/s of a detector; in an exposure, where no time is given"),
]
LightFluctuation = Annotated[
    float | None,
    typer.Option(help="relative standard deviation of the light from frame to frame"),
]
Trust = Annotated[
    bool, typer.Option("--trust", help="run the code of the classifier that the design names")
]
Draws = Annotated[int, typer.Option(help="noise draws of each scene")]
NoiseSeed = Annotated[int, typer.Option(help="seed of the noise")]

# many designs

Ratios = Annotated[
    str | None,
    typer.Option(help="readouts divided by pixels, m/N for one detector, such as 0.01,0.04,0.09"),
]
Designs = Annotated[str | None, typer.Option(help="names, separated by commas")]
Trials = Annotated[int | None, typer.Option(help="training seeds for each point")]
Folds = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=100,
        help="parts of the scenes, each tested by designs that are trained on the others, so that "
        "every scene is tested once; 1 for none. Unless given 5 where a test part was drawn from "
        "the scenes and has fewer than 300",
    ),
]


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
        help="input, or channel, of the counter, 1 for the first, as `inspect` numbers them; one "
        "for each detector, on two arms first those that see mirrors ON",
    ),
]
Marker = Annotated[
    int | None,
    typer.Option(
        min=0, max=3, help="marker input of the trigger, 0 for the first, as `inspect` numbers them"
    ),
]


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
    from deepfsi.base import seconds

    try:
        return seconds(text)
    except ValueError as error:
        raise InputError(f"--{option}: {error}") from None


def optional_seconds(option: str, text: str | None) -> float | None:
    """Seconds of a time, or None where none is given."""
    return None if text is None else seconds(option, text)


Scenes = Annotated[
    Path, typer.Option(help="image, or folder of images, with or without a folder for each class")
]
Projector = Annotated[str, typer.Option(help="virtual, vialux; for recorded runs also dlpc900")]
Counter = Annotated[
    str,
    typer.Option(
        help="virtual, picoquant, swabian, or followed: its software writes OUT/photons.ptu"
    ),
]
CounterConfig = Annotated[
    Path | None,
    typer.Option(
        help="file with the trigger levels of the inputs. picoquant: snAPI's .ini file; swabian: "
        "TOML, a table [trigger_levels] of channels and volts"
    ),
]
MarkerChannel = Annotated[
    int | None,
    typer.Option(help="swabian: channel of the trigger, negative for falling edges"),
]
AlpVersion = Annotated[
    str | None, typer.Option(help="vialux: version of the ALP interface, 4.3 unless given")
]
Latency = Annotated[
    list[str] | None,
    typer.Option(
        help="NAME=TIME of a virtual device: load, display, command, trigger, block, transfer "
        "or decision, such as command=1ms"
    ),
]
Virtual = Annotated[
    str | None,
    typer.Option(
        help="virtual camera: ideal, pmt, spad, or a TOML file; with the dark counts and dead time "
        "of the design's camera unless given, or pmt where that is no laboratory's"
    ),
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


def wiring(inputs: list[int] | None, marker: int | None) -> dict[str, Any]:
    """Settings of an acquisition that say which inputs of the counter are used, as far as given."""
    from deepfsi.hardware.counting import Acquisition

    most = Acquisition.MOST_INPUTS
    for each in inputs or ():
        if not 1 <= each <= most:
            raise InputError(f"--input {each} is not allowed: give 1 to {most}")
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


def check_sigma(given: Mapping[str, Any], noises: Iterable[str]) -> None:
    """Raise `InputError` if read noise is given and none of these noises has any."""
    from deepfsi.camera import find_noise

    # a stand-in is of what it stands for
    named = [noise for noise in dict.fromkeys(noises) if not find_noise(noise).stands_for]
    if "sigma" in given and not any(find_noise(noise).read_noise for noise in named):
        raise InputError(
            f"--sigma is not of {' and '.join(named)} noise: leave it out, or give --noise "
            "gaussian or camera"
        )


def check_test(job: "Job") -> None:
    """Raise `InputError` unless a design can be tested under its camera's noise."""
    from deepfsi.physics import noise_of

    noise_of(job.camera)
    if faults := job.exposure.test_faults((job.camera.noise_name,)):
        raise InputError(join_messages(faults))


def job_settings(
    given: Mapping[str, Any], data: "Dataset", matrix: "np.ndarray | None"
) -> dict[str, Any]:
    """Fields of a job of the options of `design`, for `learn`."""
    # The data decides how many masks a design of a fixed number has; the matrix, (m, N), is the
    # user's own
    from deepfsi.camera import Camera
    from deepfsi.jobs import sorted_settings

    settings = dict(given)
    if "photons" in settings:
        lowest, highest = budget_range(settings["photons"])
        settings |= {"photons": lowest, "span": highest / lowest}
    if "masks" in settings:
        settings["masks"] = whole_number("masks", settings["masks"])
    job = sorted_settings(settings)
    job["camera"] = Camera.load(job.get("camera"))
    if matrix is not None:
        if "masks" in job or job.get("design", "custom") != "custom":
            raise InputError(
                "--matrix is a design with its own masks: leave --masks and --design out"
            )
        return {**job, "design": "custom", "masks": len(matrix)}
    if "masks" not in job:
        job["masks"] = _fixed_count(job, data)
    return job


def _fixed_count(job: Mapping[str, Any], data: "Dataset") -> int:
    """Number of masks of a design that has no choice, or `InputError`."""
    from deepfsi.camera import ONE_DETECTOR
    from deepfsi.jobs import DESIGNS, check_design, count_allowed, find_exposure

    exposure = find_exposure(job.get("exposure", {}))
    if exposure.fixed_mask_count:
        return exposure.fixed_mask_count
    design = check_design(job.get("design", "deepfsi"))
    code = DESIGNS[design]
    if not code.complete:
        raise InputError(f"{design} needs a number of masks: add --masks, for instance --masks 10")
    scene = exposure.scene(data)
    camera = job["camera"]
    detectors = ONE_DETECTOR if code.every_pixel else camera.detector_map(scene.image_shape)
    return count_allowed(design, scene, detectors)[1]


def recipe_fields(
    data: str | None,
    size: str | None,
    skip_bad: bool,
    normal: str | None,
    designs: str | None,
    ratios: str | None,
    trials: int | None,
    folds: int | None = None,
) -> dict[str, Any]:
    """Fields of a recipe that are no settings of a job, None where one is not given."""
    return {
        "data": data,
        "size": size_of(size),
        "skip_bad": skip_bad or None,
        "normal": normal,
        "designs": words(designs),
        "ratios": numbers("ratios", ratios),
        "trials": trials,
        "folds": folds,
    }


def recipe_settings(
    given: Mapping[str, Any], own: Mapping[str, Any], base: Mapping[str, Any]
) -> dict[str, Any]:
    """Settings of the recipe that the options of `compare` or `plan` ask for."""
    # Options of a job are axes, as text; `own` are fields of the recipe, None where one is not
    # given; settings of `base` hold where no option overrides them
    from deepfsi.camera import Camera
    from deepfsi.jobs import find_table

    fields = {name: value for name, value in own.items() if value is not None}
    if "masks" in given and "ratios" in fields:
        raise InputError("--masks and --ratios are two ways to say one thing: give one, not both")
    tables: dict[str, dict[str, Any]] = {"camera": {}, "exposure": {}, "training": {}}
    if "camera" in given:
        tables["camera"] = Camera.load(given["camera"]).given_fields
    for name, text in given.items():
        table, key = find_table(name)
        if name != "camera":
            if name == "hidden":  # widths of one network
                tables[table][key] = [numbers(name, text, whole=True)]
            elif table:
                tables[table][key] = values(name, text)
            else:
                fields[key] = numbers(name, text, whole=name == "masks")
    replaced = {"masks": "ratios", "ratios": "masks"}
    left_out = {replaced[name] for name in fields if name in replaced}
    merged = {name: value for name, value in base.items() if name not in left_out} | fields
    for name, axes in tables.items():
        held = merged.get(name, {})
        if isinstance(held, dict) and axes:
            merged[name] = {**held, **axes}
    if isinstance(tuned := merged.get("tuned"), dict):
        merged["tuned"] = {
            design: {name: value for name, value in table.items() if name not in tables["training"]}
            if isinstance(table, dict)
            else table
            for design, table in tuned.items()
        }
    return merged
