"""Settings of commands: how one is declared, the kinds that many have, and their checks.

A setting is a field of a model: its type says how its text is read, its words are in `--help`.
Settings of a model in a lower room are not declared again: `OptionsOf` takes them from there.
"""

import re
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, Field
from pydantic.fields import FieldInfo

from deepfsi.base.errors import InputError
from deepfsi.base.files import check_ending
from deepfsi.base.models import Count, Seconds, WholeNumber
from deepfsi.camera.camera import Camera
from deepfsi.camera.detectors import MOST_INPUTS
from deepfsi.datasets.catalog import DATASETS
from deepfsi.datasets.load import find_source
from deepfsi.designfile.design_file import find_design
from deepfsi.jobs.designs import read_matrix
from deepfsi.jobs.exposures import SharedLight
from deepfsi.jobs.job import Job
from deepfsi.jobs.training import Training


def option(words: str, default: Any = None, **keywords: Any) -> Any:
    """Field of an option; one whose default is ``...`` must be given."""
    return Field(default, description=words, **keywords)


def argument(words: str, metavar: str = "", default: Any = ...) -> Any:
    """Field of a value that stands without a name on the command line."""
    return Field(default, description=words, json_schema_extra={"argument": metavar})


@dataclass(frozen=True)
class OptionsOf:
    """Options made from fields of models; a command gets those that were set as a `dict`."""

    fields: Mapping[str, tuple[str, str, FieldInfo]]  # by name: heading, name in its table, field
    axes: bool = False  # True if each takes several values


_OPTICS = ("light", "rails", "detectors", "device", "exposure", "levels", "flux", "dark", "noise")
_TABLES: tuple[tuple[str, type[BaseModel], tuple[str, ...]], ...] = (
    ("Options", Job, ("design", "masks", "photons", "camera", "seed")),
    ("Camera", Camera, _OPTICS),
    ("Training", Training, ("epochs", "batch", "mask_lr", "hidden", "counts", "clusters")),
    ("Exposure", SharedLight, ("cap",)),
)
# `--device` is where torch computes. Rarer settings are in a camera's file, a recipe or Python
JOB_OPTIONS = {
    "dmd" if name == "device" else name: (heading, name, model.model_fields[name])
    for heading, model, names in _TABLES
    for name in names
}
"""Options of a job by name: heading (its table in the job), name there, and field."""


def job_options(*, axes: bool = False, leave: Iterable[str] = ()) -> OptionsOf:
    """Options of the settings of a job: its camera, its exposure and its training."""
    return OptionsOf({name: JOB_OPTIONS[name] for name in JOB_OPTIONS if name not in leave}, axes)


def camera_options(*names: str) -> OptionsOf:
    """Options of fields of a camera, and of the camera itself by the name `camera`."""
    fields = {"camera": Job.model_fields["camera"], **Camera.model_fields}
    return OptionsOf({name: ("Camera", name, fields[name]) for name in names})


@dataclass(frozen=True)
class Output:
    """Where a command writes, checked before its work."""

    endings: tuple[str, ...] = ()
    new: bool = False  # True for a folder that must be missing or empty

    def check(self, path: Path, force: bool) -> None:
        """Raise `InputError` if the path cannot be written; `force` allows to replace a file."""
        if self.new and path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise InputError(f"{path} exists already: give a new folder")
        if self.endings:
            check_ending(path, self.endings)
            if path.exists() and not force:
                raise InputError(
                    f"{path} exists already: give another name, or --force to replace it"
                )
        folder = path.parent if self.endings or self.new else path
        existing = next(path for path in (folder, *folder.parents) if path.exists())
        try:
            # A full disk may take a file, but no bytes
            with tempfile.TemporaryFile(dir=existing) as file:
                file.write(bytes(2**20))
        except OSError as error:
            raise InputError(
                f"cannot write to {path}: {error.strerror}; give another place"
            ) from None


def split_commas(text: str) -> list[str]:
    """Values in a text between commas; `ValueError` if one is empty."""
    values = [value.strip() for value in text.split(",")]
    if not all(values):
        raise ValueError(
            f"{text!r} has an empty place: give one value or more, separated by commas"
        )
    return values


def height_width(text: str) -> tuple[int, int]:
    """Height and width, from HEIGHTxWIDTH or from a number for both."""
    sides = text.lower().split("x")
    if len(sides) > 2 or not all(re.fullmatch("[1-9][0-9]{0,3}", side) for side in sides):
        raise ValueError(f"{text!r} is not allowed: give HEIGHTxWIDTH, such as 32x32, below 10000")
    return int(sides[0]), int(sides[-1])


def _existing(path: Path) -> Path:
    if not path.exists():
        raise InputError(f"there is nothing at {path}: give another path")
    return path


def _known_source(source: str) -> str:
    find_source(source)
    return source


NumberList = Annotated[tuple[float, ...], BeforeValidator(split_commas)]
Names = Annotated[tuple[str, ...], BeforeValidator(split_commas)]
HeightWidth = Annotated[tuple[int, int], BeforeValidator(height_width)]
ExistingPath = Annotated[Path, AfterValidator(_existing)]

# scenes

Source = Annotated[str, AfterValidator(_known_source)]
Size = Annotated[HeightWidth | None, option("resize images to HEIGHTxWIDTH, or a number for both")]
TrainingData = Annotated[
    Source,
    option(f"{', '.join(DATASETS)}, a folder or .csv list of images, a cube, or an .npz file"),
]
TestData = Annotated[Source | None, option("data, as for `design`; default: the design's own")]
View = Annotated[
    ExistingPath | None, option("folder of a calibration: scenes as its camera sees them")
]

# a design and its test

DesignPath = Annotated[Path, AfterValidator(find_design)]
DesignOrPatterns = Annotated[DesignPath, argument("design file, or a folder of its patterns")]
NoiseSeed = Annotated[WholeNumber, option("seed of the noise")]
Matrix = Annotated[
    Any,
    AfterValidator(read_matrix),
    option("your own masks, (m, N) or (m, H, W): .npy or .mat (FILE.mat:VARIABLE)"),
]

# how it runs, and what it writes

NewFolder = Annotated[Path, Output(new=True)]
CsvFile = Annotated[Path | None, Output((".csv",))]

Trust = Annotated[bool, option("run the code of the classifier that the design names")]
TorchDevice = Annotated[str, option("auto, cpu, cuda, one of several GPUs such as cuda:1, or mps")]
WorkerCount = Annotated[Count | None, option("processes; default: one for each core; with folds 1")]
Ray = Annotated[str | None, option("work on a Ray cluster: its address, auto or local")]
Force = Annotated[bool, option("replace what is at --out")]

# acquisitions

DeadTimes = Annotated[dict[str, Any], camera_options("camera", "dead_time", "dead_time_model")]
PatternFolder = Annotated[Path, argument("folder of patterns")]
RunFolder = Annotated[Path, argument("acquisition folder, with photons.ptu in it")]
SettleTime = Annotated[
    Seconds | None,
    option(
        "time for mirrors to settle; default: the device's, or the recorded one", alias="settle"
    ),
]
Repeats = Annotated[
    Count | None, option("exposures in a pass; default: as many as fit, or were recorded")
]
# People count inputs from 1
Input = Annotated[int, Field(ge=1, le=MOST_INPUTS), AfterValidator(lambda number: number - 1)]
Inputs = Annotated[
    tuple[Input, ...],
    option(
        "input, or channel, of the counter, 1 for the first, as `inspect` numbers them; one for "
        "each detector, on two arms first those that see mirrors ON",
        alias="input",
    ),
]
Marker = Annotated[int, Field(ge=0, le=3), AfterValidator(lambda number: 1 << number)]
MarkerBit = Annotated[
    Marker | None,
    option("marker input of the trigger, 0 for the first, as in `inspect`", alias="marker"),
]

# studies

Ratios = Annotated[NumberList | None, option("readouts divided by pixels, such as 0.01,0.04,0.09")]
