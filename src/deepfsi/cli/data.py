"""Commands of data sets by name."""

import os
from pathlib import Path
from typing import Annotated

import typer

from deepfsi.cli import common, options, paths
from deepfsi.cli.groups import Group

app = typer.Typer(
    cls=Group,
    invoke_without_command=True,
    callback=common.help_if_bare,
    help="Data sets that have a name: list, download, check and export them.\n\n"
    "Example: deepfsi data list",
)


@app.command("list")
def data_list(as_json: options.Json = False) -> None:
    """List the data sets that have a name, and where they are.

    Example: deepfsi data list --json
    """
    from deepfsi.datasets import list_datasets

    known = list_datasets()
    if as_json:
        common.print_json("data.list", {"data_sets": [entry._asdict() for entry in known]})
        return
    rows = [(*map(str, entry[:-1]), _shown(entry.where)) for entry in known]
    common.print_table("data sets", ("name", "images", "pixels", "classes", "where"), rows)


def _shown(where: str) -> str:
    """A folder from $DEEPFSI_DATA or the home folder on, for a table."""
    for folder, name in ((os.environ.get("DEEPFSI_DATA"), "$DEEPFSI_DATA"), (Path.home(), "~")):
        if folder and Path(where).is_relative_to(folder):
            return str(Path(name) / Path(where).relative_to(folder))
    return where


@app.command("download")
def data_download(
    name: Annotated[str, typer.Argument(help="name of a data set")], as_json: options.Json = False
) -> None:
    """Fetch a data set once, checked by hash.

    Example: deepfsi data download mnist
    """
    from deepfsi.datasets import download

    where = download(name)
    if as_json:
        common.print_json("data.download", {"name": name, "where": str(where)})
    else:
        print(f"{name}: {where}")


@app.command("check")
def data_check(
    name: Annotated[str, typer.Argument(help="name of a data set")], as_json: options.Json = False
) -> None:
    """Compare a data set's files with their known hashes.

    Example: deepfsi data check mnist
    """
    from deepfsi.datasets import check

    files = check(name)
    if as_json:
        common.print_json(
            "data.check", {"name": name, "files": [entry._asdict() for entry in files]}
        )
    else:
        rows = [(str(f.file), "good" if f.ok else "BAD", f.detail) for f in files]
        common.print_table(name, ("file", "state", "detail"), rows)
    if not all(entry.ok for entry in files):
        raise typer.Exit(1)


@app.command("export")
def data_export(
    name: Annotated[
        str,
        typer.Argument(
            help="name, folder of images or .npz file; or a design file, for the test scenes of "
            "what it was trained on, at its size"
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="folder for the pictures, new")],
    per_class: Annotated[int, typer.Option(min=1, help="test scenes of each class")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="seed of their choice")] = 0,
    size: options.Size = None,
    as_json: options.Json = False,
) -> None:
    """Write test scenes as pictures to show to a camera, in a folder for each class.

    Example: deepfsi data export mnist --per-class 2 -o images
    """
    paths.check_new_folder(out)
    from deepfsi.datasets import write_display

    shown = options.size_of(size)
    if name.endswith(".safetensors"):
        from deepfsi.lab import data_of_file

        scenes = data_of_file(paths.check_design(Path(name)), shown)
    else:
        scenes = common.load(name, shown)
    written = write_display(scenes, out, per_class, seed)
    common.print_pictures("data.export", written, out, as_json)
