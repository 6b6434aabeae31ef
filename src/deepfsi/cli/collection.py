"""Commands of published designs: make a collection, and list one."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepfsi.cli import common, options, paths
from deepfsi.cli.groups import Group

if TYPE_CHECKING:
    from deepfsi.designfile import PublishedDesign

app = typer.Typer(
    cls=Group,
    invoke_without_command=True,
    callback=common.help_if_bare,
    help="Published designs, which go by a name: make a collection of them, list one.\n\n"
    "Example: deepfsi designs make --only dmd-mnist -o published",
)


@app.command("make")
def designs_make(
    out: options.Folder,
    source: Annotated[
        Path | None,
        typer.Argument(metavar="[LIST]", help="your own list, TOML; the package's unless given"),
    ] = None,
    only: Annotated[
        str | None, typer.Option(help="names, separated by commas; all unless given")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Train, test and write the designs of a list, each with a card, and their index.

    Designs that are already in the folder are kept. Ctrl-C keeps those that are finished, and the
    same command goes on.

    Example: deepfsi designs make -o published
    """
    paths.check_folder(out)
    from deepfsi.sweeps.collection import Collection, make

    collection, made = Collection.read(source), {}
    command = "deepfsi designs make" + (f" {source.name}" if source else "")
    for one in make(
        collection, out, options.words(only), command, lambda name: common.progress(name, as_json)
    ):
        made[one.name] = one.entry
        if not as_json:
            print(f"{one.name}: {'there already, ' * one.there}{_told(one.entry)}", flush=True)
    if as_json:
        common.print_json("designs.make", {"folder": str(out), "designs": _json(made)})
        return
    print(f'open one with DEEPFSI_DESIGNS={out} and its name, as deepfsi.load_design("{one.name}")')


@app.command("list")
def designs_list(as_json: options.Json = False) -> None:
    """List the published designs at hand.

    They are those that come with the package, and those in the folder, or at the address, that
    DEEPFSI_DESIGNS names.

    Example: deepfsi designs list
    """
    from deepfsi.designfile import SHIPPED_DESIGNS, read_indexes

    collections = {
        "shipped with the package" if where == str(SHIPPED_DESIGNS) else where: designs
        for where, designs in read_indexes().items()
    }
    if as_json:
        told = [{"where": where, "designs": _json(each)} for where, each in collections.items()]
        common.print_json("designs.list", {**told[0], "collections": told})
        return
    heads = ("name", "recognises", "photons", "accuracy")
    for where, designs in collections.items():
        rows = [
            (name, each.recognises, common.budget(each.photons), _share(each))
            for name, each in designs.items()
        ]
        common.print_table(where, heads, rows)


def _told(entry: "PublishedDesign") -> str:
    return f"test accuracy {_share(entry)} at {common.budget(entry.photons)} photons"


def _share(entry: "PublishedDesign") -> str:
    return common.share(entry.accuracy, entry.low, entry.high)


def _json(designs: "dict[str, PublishedDesign]") -> dict[str, dict[str, object]]:
    return {name: entry.model_dump() for name, entry in designs.items()}
