"""Input and output shared by the commands: files, tables, figures, progress."""

import json
import re
import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from deepfsi.base import Message, Progress, count_text, readable_name, terminal_bar
from deepfsi.cli import paths

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

    from deepfsi.datasets import Dataset
    from deepfsi.design import Design
    from deepfsi.measures import Estimates, Result
    from deepfsi.sweeps import Data, Point


def as_options(text: str) -> str:
    """A message with the settings that it names as options: `size` is --size."""
    return text.write(_as_option) if isinstance(text, Message) else text


def _as_option(setting: str, value: str) -> str:
    return f"--{setting.replace('_', '-')} {value}".rstrip()


def is_given(context: typer.Context, parameter: str) -> bool:
    """True of a parameter that stands on the command line."""
    source = context.get_parameter_source(parameter)
    return source is not None and source.name == "COMMANDLINE"


def help_if_bare(context: typer.Context) -> None:
    """Print the help of a group of commands that is given without one."""
    if context.invoked_subcommand is None:
        print(context.get_help())


def load(
    data: str, size: tuple[int, int] | None, view: Path | None = None, **options: Any
) -> "Dataset":
    """Data set of a name or path, as the camera calibrated in the folder `view` sees it."""
    from deepfsi.datasets import load_dataset

    scenes = load_dataset(data, size=size, **options)
    if view is None:
        return scenes
    from deepfsi.hardware.calibration import view_dataset

    return view_dataset(scenes, view)


def check_data(source: str | None, view: Path | None = None) -> None:
    """Raise `InputError` unless there is such data, if told, and the folder of a camera's view."""
    from deepfsi.datasets import check_source

    if source is not None:
        check_source(source)
    if view is not None:
        paths.check_there(view, "the folder of a camera's calibration")


def print_data(data: "Dataset | Data", notes: Sequence[str] = ()) -> None:
    """Say in one line what was done to the scenes of a data set, and notes on it."""
    print(f"data: {data.name}. {data.preprocessing}")
    for note in notes:
        print(f"note: {note}")


def open_any(path: Path, trust: bool = False) -> "Design":
    """A design file, or a folder of patterns as `open_design` takes it."""
    from deepfsi.design import load_design

    return open_design(path, trust) if path.is_dir() else load_design(path, trust=trust)


def open_design(path: Path, trust: bool = False) -> "Design":
    """A design of masks, or what a folder of patterns realises of the design in it."""
    from deepfsi.design import Design

    file = path / "design.safetensors" if path.is_dir() else path
    made = Design.load(file, trust=trust)
    made.exposure.check("masks", str(file))
    if not path.is_dir():
        return made
    from deepfsi.hardware.patterns import check_patterns

    return made.as_shown(*check_patterns(path).realised)


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure as the kind that its name ends in, whole or not at all."""
    import io

    from deepfsi.base import write_atomically
    from deepfsi.report.style import drawing

    picture = io.BytesIO()
    with drawing():
        figure.savefig(picture, dpi=160, format=path.suffix.lower()[1:])
    write_atomically(path, picture.getvalue())


def draw(command: str, figure: "Figure", path: Path, as_json: bool) -> None:
    """Write a command's figure, and say where."""
    save_figure(figure, path)
    if as_json:
        print_json(command, {"picture": str(path)})
    else:
        print(f"drawn: {path}")


def read_matrix(source: str | None) -> "np.ndarray | None":
    """A user's own sensing matrix (m, N)."""
    from deepfsi.jobs import read_matrix as read

    return None if source is None else read(source)


def command_line() -> str:
    """Command as it was typed, for records and pages."""
    return shlex.join(["deepfsi", *map(readable_name, sys.argv[1:])])


NAME_WIDTH = 13
"""Characters of a name in a table, such as that of a class."""

JSON_SCHEMA = 1
"""Version of what every command prints with --json; raised where a field changes or goes."""


def print_json(command: str, value: Mapping[str, Any]) -> None:
    """Print what a command found for scripts, its schema first: "deepfsi.camera.count/1"."""
    schema = {"schema": f"deepfsi.{command}/{JSON_SCHEMA}"}
    text = json.dumps({**schema, **value, **schema}, ensure_ascii=False)
    # bytes of a path that are no UTF-8, which no reader of JSON takes
    text = re.sub("[\udc80-\udcff]", lambda byte: f"\\\\x{ord(byte[0]) - 0xDC00:02x}", text)
    print(json.dumps(json.loads(text), indent=1))


def print_pictures(command: str, written: Sequence[Path], folder: Path, as_json: bool) -> None:
    """Say which pictures a command wrote to a folder."""
    if as_json:
        print_json(command, {"folder": str(folder), "pictures": [str(path) for path in written]})
    else:
        print(f"{len(written)} pictures: {folder}")


def print_table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table whose first column is words, one line a row where the width allows it."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    table.padding, table.min_width = (0, 1, 0, 0), len(title)
    for number, head in enumerate(heads):
        table.add_column(head, justify="right" if number else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    console = Console(markup=False, emoji=False, highlight=False)
    if not console.is_terminal:  # a file or a pipe has no width
        unbounded = console.options.update(max_width=sys.maxsize)
        console.width = max(console.width, console.measure(table, options=unbounded).maximum)
    console.print(table)


def budget(photons: float) -> str:
    """Photons as all commands print and take them: 1e4, 3.16e4."""
    mantissa, exponent = f"{photons:.2e}".split("e")
    return f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}"


def counted(
    tests: "Sequence[Result | Estimates | Point]",
) -> tuple[tuple[str, ...], list[tuple[str, ...]], str]:
    """Heads and cells of what detectors count, and what they mean; of clicks with the photons."""
    if not any(test.clicks for test in tests):
        meaning = "counts: photons that detectors count, in the mean over test scenes"
        return ("counts",), [(count_text(test.counts),) for test in tests], meaning
    meaning = "counts: clicks of the detectors, arriving: photons that reach them"
    cells: list[tuple[str, ...]] = [
        (count_text(test.counts), "–" if test.arriving is None else count_text(test.arriving))
        for test in tests
    ]
    return ("counts", "arriving"), cells, f"{meaning}, in the mean over test scenes"


def share(mean: float, low: float, high: float) -> str:
    """A rate with half the width of its interval: 0.565 ± 0.027."""
    return f"{mean:.3f} ± {(high - low) / 2:.3f}"


def error(rmse: float, bound: float | None) -> str:
    """A root mean squared error, and in brackets a bound where there is one: 0.052 (0.071)."""
    return f"{rmse:.3g}" if bound is None else f"{rmse:.3g} ({bound:.3g})"


def several(number: int, what: str) -> str:
    """A number of things: 1 exposure, 2 exposures."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def short(name: str, width: int = NAME_WIDTH) -> str:
    """Beginning of a long name, for a table."""
    return name if len(name) <= width else f"{name[: width - 1]}…"


def worst_class(rate: float, name: str, width: int = NAME_WIDTH) -> str:
    """Accuracy of the worst class with its name: 0.083 (oak)."""
    return f"{rate:.3f} ({short(name, width)})"


def size(made: "Design") -> str:
    """Masks, looks and detectors of a design: 5 masks, 2 looks, 4 detectors, both rails read."""
    if made.exposure.makes_masks:
        return f"{made.masks} looks"
    parts = [f"{made.masks} masks"]
    if made.exposure.chooses:
        parts.append(f"{made.exposure.looks} looks")
    if made.detection.count > 1:
        parts.append(f"{made.detection.count} detectors")
    if made.rails.count == 2 and made.detection.readout == "both":
        parts.append("both rails read")
    return ", ".join(parts)


def detectors_text(design: str, detectors: str) -> str:
    """Detectors in a table, also of a design that has one for each pixel."""
    from deepfsi.jobs import EVERY_PIXEL

    return "each pixel" if design in EVERY_PIXEL else detectors


def progress(what: str, quiet: bool) -> AbstractContextManager[Progress]:
    """Progress bar on standard error with the time left."""
    return terminal_bar(what, quiet)
