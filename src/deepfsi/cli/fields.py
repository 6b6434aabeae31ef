"""Settings of commands: how one is declared, the kinds that many have, and their checks.

A setting is a field of a model. Its type is what is read of a text; its words are what `--help`
shows. Options of what has a model in a lower room are not written again: `OptionsOf` takes them
from there.
"""

import re
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field
from pydantic.fields import FieldInfo

from deepfsi.base.errors import InputError
from deepfsi.base.files import check_ending
from deepfsi.base.models import Count, Seconds, WholeNumber
from deepfsi.camera.camera import Camera
from deepfsi.camera.detectors import MOST_INPUTS
from deepfsi.datasets.load import check_source
from deepfsi.designfile.design_file import find_design
from deepfsi.jobs.exposures import exposure_kinds
from deepfsi.jobs.job import SETTING_ALIASES, Job
from deepfsi.jobs.training import Training

FIRST = "Options"
"""Heading of the options that most need."""


def option(words: str, default: Any = None, **more: Any) -> Any:
    """Field of an option; one whose default is ``...`` must be given."""
    return Field(default, description=words, **more)


def argument(words: str, metavar: str = "", default: Any = ...) -> Any:
    """Field of a value that stands without a name on the command line."""
    return Field(default, description=words, json_schema_extra={"argument": metavar})


@dataclass(frozen=True)
class OptionsOf:
    """Options made from fields of models, for a command's `dict` of those that were given."""

    fields: Mapping[str, tuple[str, FieldInfo]]  # by name: heading, and field
    axes: bool = False  # True if each takes several values


@dataclass(frozen=True)
class Output:
    """Where a command writes, checked before its work."""

    endings: tuple[str, ...] = ()
    new: bool = False  # True of a folder that may not be there, or is empty

    def check(self, path: Path, force: bool) -> None:
        """Raise `InputError` unless this can be written there; `force` lets it replace a file."""
        if self.new and path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise InputError(f"{path} exists already: give a new folder")
        if self.endings and path.is_dir():
            ends = " or ".join(self.endings)
            raise InputError(f"{path} is a folder: give a file name ending in {ends}")
        if self.endings:
            check_ending(path, self.endings)
            if path.exists() and not force:
                raise InputError(
                    f"{path} exists already: give another name, or --force to replace it"
                )
        folder = path.parent if self.endings or self.new else path
        there = next(each for each in (folder, *folder.parents) if each.exists())
        if not there.is_dir():
            raise InputError(f"cannot write to {path}: {there} is a file; give another place")
        try:
            with tempfile.TemporaryFile(dir=there) as file:
                file.write(bytes(2**20))  # a file may be made where nothing can be written into it
        except OSError as error:
            raise InputError(
                f"cannot write to {path}: {error.strerror}; give another place"
            ) from None


def job_options(*, axes: bool = False, leave: Iterable[str] = ()) -> OptionsOf:
    """Options of the settings of a job: its camera, its exposure and its training."""
    # The rarer ones a camera's file gives, and a recipe or Python
    optics = ("light", "rails", "detectors", "device", "exposure", "levels", "flux", "dark")
    learning = ("epochs", "batch", "mask_lr", "hidden", "counts", "clusters")
    names = {field: option for option, field in SETTING_ALIASES.items()}
    job = ("design", "masks", "photons", "camera", "seed")
    fields = {name: (FIRST, Job.model_fields[name]) for name in job}
    for table, fields_of, typed in (
        ("camera", Camera.model_fields, (*optics, "noise")),
        ("training", Training.model_fields, learning),
    ):
        fields |= {
            names.get((table, name), name): (table.capitalize(), fields_of[name]) for name in typed
        }
    fields |= {
        name: ("Exposure", kind.model_fields[name])
        for name, kind in exposure_kinds().items()
        if name != "span"
    }
    return OptionsOf({name: each for name, each in fields.items() if name not in leave}, axes)


def camera_options(*names: str) -> OptionsOf:
    """Options of fields of a camera, and of the camera itself by the name `camera`."""
    fields = {"camera": Job.model_fields["camera"], **Camera.model_fields}
    return OptionsOf({name: ("Camera", fields[name]) for name in names})


def check_design_file(path: Path) -> Path:
    """Path of a design file, of a folder of patterns, or of a published design by its name."""
    file = find_design(path)
    if not file.exists():
        raise InputError(f"no design file at {path}: make one with `deepfsi design`")
    return file


def split_commas(text: Any) -> Any:
    """Parts of a text between commas; `ValueError` if one is empty."""
    if not isinstance(text, str):
        return text
    parts = [part.strip() for part in text.split(",")]
    if not all(parts):
        raise ValueError(
            f"{text!r} has an empty place: give one value or more, separated by commas"
        )
    return parts


def height_width(text: Any) -> Any:
    """Height and width, from HEIGHTxWIDTH or from a number for both."""
    if not isinstance(text, str):
        return text
    sides = text.lower().split("x")
    if len(sides) > 2 or not all(re.fullmatch("[1-9][0-9]{0,3}", side) for side in sides):
        raise ValueError(f"{text!r} is not allowed: give HEIGHTxWIDTH, such as 32x32, below 10000")
    return int(sides[0]), int(sides[-1])


def _existing(path: Path) -> Path:
    if not path.exists():
        raise InputError(f"there is nothing at {path}: give another path")
    return path


NumberList = Annotated[tuple[float, ...], BeforeValidator(split_commas)]
"""Numbers, separated by commas."""

Names = Annotated[tuple[str, ...], BeforeValidator(split_commas)]
"""Names, separated by commas."""

HeightWidth = Annotated[tuple[int, int], BeforeValidator(height_width)]
"""Height and width of an image, of HEIGHTxWIDTH or one number for both."""

ExistingPath = Annotated[Path, AfterValidator(_existing)]
"""Path at which there is something."""

# scenes

Size = Annotated[
    HeightWidth | None, Field(description="resize images to HEIGHTxWIDTH, or one number for both")
]
DataSource = Annotated[str, AfterValidator(check_source)]
"""Name or path of data that are there."""

TrainingData = Annotated[
    DataSource,
    Field(
        description="name (deepfsi data list), folder of images, .csv of file names and "
        "labels or values, cube, or .npz"
    ),
]
TestData = Annotated[
    DataSource | None,
    Field(description="name or path, as for `design`; default: the design's own"),
]
View = Annotated[
    ExistingPath | None,
    Field(description="folder of a camera's calibration: take the scenes as this camera sees them"),
]

# a design and its test

DesignPath = Annotated[Path, AfterValidator(check_design_file)]
"""Design file, folder of patterns or name of a published design, which is there."""

DesignOrPatterns = Annotated[
    DesignPath, argument("design file, or a folder of patterns that `dmd export` wrote")
]
NoiseSeed = Annotated[WholeNumber, Field(description="seed of the noise")]
Matrix = Annotated[
    str | None,
    Field(
        description="your own masks: .npy or .mat (FILE.mat:VARIABLE) of shape (m, N) or (m, H, W)"
    ),
]

# how it runs

Trust = Annotated[bool, Field(description="run the code of the classifier that the design names")]
TorchDevice = Annotated[
    str, Field(description="auto, cpu, cuda, one of several GPUs such as cuda:1, or mps")
]
WorkerCount = Annotated[Count | None, Field(description="processes; default: one for each core")]
Ray = Annotated[str | None, Field(description="work on a Ray cluster: its address, auto or local")]
Force = Annotated[bool, Field(description="replace what is at --out")]

# acquisitions

PatternFolder = Annotated[Path, argument("folder of patterns")]
RunFolder = Annotated[Path, argument("acquisition folder, with photons.ptu in it")]
SettleTime = Annotated[
    Seconds | None,
    Field(
        alias="settle",
        description="time for mirrors to settle in each frame; default: the device's, or the "
        "recorded one",
    ),
]
Repeats = Annotated[
    Count | None,
    Field(description="exposures in one pass; default: as many as fit, or were recorded"),
]
Inputs = Annotated[
    tuple[
        Annotated[int, Field(ge=1, le=MOST_INPUTS), AfterValidator(lambda number: number - 1)],
        ...,
    ],
    Field(
        alias="input",
        description="input, or channel, of the counter, 1 for the first, as `inspect` numbers them;"
        " one for each detector, on two arms first those that see mirrors ON",
    ),
]
"""Inputs of a counter, from 0, where people count from 1."""

MarkerBit = Annotated[
    Annotated[int, Field(ge=0, le=3), AfterValidator(lambda number: 1 << number)] | None,
    Field(
        alias="marker",
        description="marker input of the trigger, 0 for the first, as `inspect` numbers them",
    ),
]
"""Bit of a marker input, of its number."""

ExposureBudget = Annotated[
    float | None,
    Field(
        description="budget of an exposure in counts, detector efficiency included; default: "
        "that of the all-ON frames"
    ),
]

# studies

Ratios = Annotated[
    NumberList | None,
    Field(description="readouts divided by pixels, m/N for one detector, such as 0.01,0.04,0.09"),
]
Folds = Annotated[
    Annotated[int, Field(ge=1, le=100)] | None,
    Field(
        description="parts of the scenes, each tested by designs that are trained on the others, "
        "so that every scene is tested once; 1 for none; default: 5 where a test part was "
        "drawn from the scenes and has fewer than 300"
    ),
]
