"""What the commands share: options, parsing, printing."""

import json
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from deepfsi.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from deepfsi.datasets import Dataset
    from deepfsi.design.artifact import Design

DataOption = Annotated[
    str,
    typer.Option(
        "--data", help="name (deepfsi data list), folder or .zip of images, cube, or .npz"
    ),
]
SizeOption = Annotated[
    str | None, typer.Option(help="resize images to HEIGHTxWIDTH, or one number for both")
]
ViewOption = Annotated[
    Path | None,
    typer.Option(help="folder of a camera's calibration: use what it sees of the scenes"),
]
DeviceOption = Annotated[str, typer.Option(help="auto, cpu or cuda")]
WorkersOption = Annotated[
    int | None, typer.Option(min=1, help="processes; one for each core unless given")
]
RayOption = Annotated[str | None, typer.Option(help="work on a Ray cluster: its address, or auto")]
JsonOption = Annotated[bool, typer.Option("--json", help="print JSON and nothing else")]
LightOption = Annotated[
    str, typer.Option(help="light constraint: column, equal-dwell, free-dwell or two-arm")
]
RailsOption = Annotated[
    str, typer.Option(help="dual: signed masks of two frames each; single: non-negative masks")
]
SigmaOption = Annotated[float, typer.Option(help="gaussian read noise, counts per readout")]
TrainNoiseOption = Annotated[
    str | None,
    typer.Option(help="noise of the training, if another: ml_gauss, poisson, gaussian, none"),
]
MatrixOption = Annotated[
    str | None,
    typer.Option(
        help="your own masks: .npy or .mat (FILE.mat:VARIABLE) of shape (m, N) or (m, H, W), a "
        "folder of images, or a TIFF of m pages"
    ),
]
EpochsOption = Annotated[int | None, typer.Option(help="training epochs")]


def words(text: str | None) -> list[str] | None:
    """Parts of a text separated by commas."""
    return None if text is None else [part.strip() for part in text.split(",") if part.strip()]


def numbers(option: str, text: str | None, whole: bool = False) -> list[Any] | None:
    """Numbers separated by commas; `InputError` names the option."""
    parts = words(text)
    if parts is None:
        return None
    if not parts:
        raise InputError(f"--{option} is empty: give one number or more, separated by commas")
    return [whole_number(option, part) if whole else one(option, part) for part in parts]


def one(option: str, text: str) -> float:
    """A number, or `InputError`."""
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--{option} {text!r} is not a number") from None


def whole_number(option: str, text: str) -> int:
    """A whole number, or `InputError`."""
    value = one(option, text)
    if not value.is_integer():
        raise InputError(f"--{option} {text!r} is not a whole number")
    return int(value)


def size_of(text: str | None) -> tuple[int, int] | None:
    """Height and width of HEIGHTxWIDTH, or of one number for both."""
    if text is None:
        return None
    sides = text.lower().split("x")
    if not all(side.isdecimal() and int(side) > 0 for side in sides) or len(sides) > 2:
        raise InputError(f"--size {text!r} is not allowed: give HEIGHTxWIDTH, such as 32x32")
    return int(sides[0]), int(sides[-1])


def load(
    data: str,
    size: tuple[int, int] | None,
    view: Path | None = None,
    split: str | None = None,
) -> "Dataset":
    """The data set of that name or path, as a camera of that calibration sees it if given."""
    from deepfsi.datasets import load_dataset

    scenes = load_dataset(data, size=size, split=split)
    if view is None:
        return scenes
    from deepfsi.hardware.calibration.fit import load_calibration, view_dataset

    return view_dataset(scenes, load_calibration(view))


def open_design(path: Path) -> "Design":
    """A design file, or what a folder of patterns realises of the design in it."""
    from deepfsi.design.artifact import Design

    if not path.is_dir():
        return Design.load(path)
    from deepfsi.hardware.patterns.folder import check_patterns

    return Design.load(path / "design.safetensors").as_shown(check_patterns(path))


def check_picture(path: Path) -> None:
    """Raise `InputError` unless a picture can be drawn to that name."""
    if path.suffix.lower() not in (".png", ".svg", ".pdf") or path.is_dir():
        raise InputError(f"cannot draw to {path}: end the name in .png, .svg or .pdf")


def draw(figure: "Figure", path: Path) -> None:
    """Write a figure, whole or not at all, and say where."""
    import io

    from deepfsi.files import write_atomically

    picture = io.BytesIO()
    figure.savefig(picture, dpi=160, format=path.suffix.lower()[1:])
    write_atomically(path, picture.getvalue())
    print(f"drawn: {path}")


def read_matrix(source: str | None) -> "np.ndarray | None":
    """A user's own sensing matrix (m, N)."""
    if source is None:
        return None
    from deepfsi.optics import mask_files

    return mask_files.read_matrix(source)


def read_toml(path: Path) -> dict[str, Any]:
    """Settings of a recipe."""
    import tomllib

    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"no recipe at {path}: give a TOML file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not TOML: {error}") from None


def check_writable(folder: Path) -> None:
    """Fail before the work rather than after it, and leave nothing behind."""
    import tempfile

    there = folder
    while not there.exists():
        there = there.parent
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise InputError(
            f"cannot write to {folder}: {error.strerror}; choose another place with -o"
        ) from None


def command_line() -> str:
    """What was typed, for records and pages."""
    return shlex.join(["deepfsi", *sys.argv[1:]])


def print_json(value: Any) -> None:
    """Print a value for scripts."""
    print(json.dumps(value, indent=1))


def print_table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table whose first column is words."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for number, head in enumerate(heads):
        side: Literal["left", "right"] = "left" if number == 0 else "right"
        table.add_column(head, justify=side, overflow="fold")
    for row in rows:
        table.add_row(*row)
    Console().print(table)


@contextmanager
def progress(what: str, quiet: bool) -> Iterator[Callable[[float, str], None]]:
    """Progress bar on standard error with the time left."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.progress import TimeRemainingColumn as TimeLeft

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeLeft())
    console = Console(stderr=True)
    hidden = quiet or not console.is_terminal
    with Progress(*columns, console=console, disable=hidden, transient=True) as bar:
        task = bar.add_task(what, total=1.0)

        def tell(share: float, now: str) -> None:
            bar.update(task, completed=share, description=now or what)

        yield tell
