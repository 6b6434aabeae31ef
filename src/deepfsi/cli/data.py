"""Commands of data sets."""

import os
from pathlib import Path
from typing import Annotated

from deepfsi.base.models.strict import Count, WholeNumber
from deepfsi.base.quantities import Table
from deepfsi.cli.command import Command
from deepfsi.cli.fields import Output, Size, argument, check_design_file, option, required
from deepfsi.cli.terminal import Outcome, Terminal
from deepfsi.datasets.catalog import list_datasets
from deepfsi.datasets.display import write_display
from deepfsi.datasets.load import load_dataset


class DataList(Command):
    """`deepfsi data list`.

    Example: deepfsi data list --json
    """

    def run(self, terminal: Terminal) -> Outcome:
        """Names, sizes and places of all data sets."""
        entries = list_datasets()
        rows = [(*map(str, entry[:-1]), _short_path(entry.where)) for entry in entries]
        heads = ("name", "images", "pixels", "classes", "where")
        return Outcome(
            {"data_sets": [entry._asdict() for entry in entries]},
            [Table("data sets", heads, rows)],
        )


def _short_path(where: str) -> str:
    """A folder from $DEEPFSI_DATA or the home folder on, for a table."""
    for folder, name in ((os.environ.get("DEEPFSI_DATA"), "$DEEPFSI_DATA"), (Path.home(), "~")):
        if folder and Path(where).is_relative_to(folder):
            return str(Path(name) / Path(where).relative_to(folder))
    return where


class DataExport(Command):
    """`deepfsi data export`.

    Example: deepfsi data export mnist --per-class 2 -o images
    """

    name: str = argument(
        "name, folder of images or .npz file; or a design file, for the test scenes of what it was "
        "trained on, at its size"
    )
    out: Annotated[Path, Output(new=True)] = required("folder for the pictures, new")
    per_class: Count = option("test scenes of each class", 1)
    seed: WholeNumber = option("seed of their choice", 0)
    size: Size = None

    def run(self, terminal: Terminal) -> Outcome:
        """Pictures that were written."""
        if self.name.endswith(".safetensors"):
            from deepfsi.lab.design_data import data_of_file

            scenes = data_of_file(check_design_file(Path(self.name)), self.size)
        else:
            scenes = load_dataset(self.name, size=self.size)
        written = write_display(scenes, self.out, self.per_class, self.seed)
        return pictures_written(written, self.out)


def pictures_written(written: list[Path], folder: Path) -> Outcome:
    """Pictures that a command wrote to a folder."""
    return Outcome(
        {"folder": str(folder), "pictures": [str(path) for path in written]},
        [f"{len(written)} pictures: {folder}"],
    )
