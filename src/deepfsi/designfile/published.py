"""Published designs: design files of a collection, opened by their names.

A collection is a folder, or an address that serves one: files NAME.safetensors, a card NAME.md of
each, and `designs.json`, which holds the hash of each file. A small one comes with the package. No
torch.
"""

import os
import re
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal
from urllib.parse import urlsplit
from urllib.request import url2pathname

from pydantic import Field

from deepfsi.base.errors import InputError, as_input_error, closest_choice
from deepfsi.base.files import hash_file, read_text
from deepfsi.base.models.strict import Positive, Share, StrictModel
from deepfsi.datasets.store import cache_folder, fetch

DESIGNS_VARIABLE = "DEEPFSI_DESIGNS"
"""Environment variable: folder or address of a collection."""

SHIPPED_DESIGNS = Path(str(files(__package__) / "shipped"))
"""Folder of the collection that comes with the package."""

INDEX_NAME = "designs.json"
"""Name of the index of a collection."""

LARGEST_INDEX = 2**20
"""Bytes of an index at most."""

NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}"
"""Names of published designs."""

DesignName = Annotated[str, Field(pattern=f"^{NAME_PATTERN}$")]
_Hash = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
ShortText = Annotated[str, Field(max_length=200, pattern="^[^\x00-\x1f\x7f-\x9f]*$")]


class PublishedDesign(StrictModel):
    """A published design, as an index tells it.

    Attributes
    ----------
    sha256 : str
        Of the file NAME.safetensors, in hex.
    recognises : str
        What it tells apart, in words.
    data : str
        Data set that it was trained on.
    photons : float
        Budget Φ of its training.
    accuracy, low, high : float
        On the test scenes at that budget, with its 95 % interval, which the card explains.
    recipe : str
        SHA-256 of the settings that it was made with.
    """

    sha256: _Hash
    recognises: ShortText
    data: ShortText
    photons: Positive
    accuracy: Share
    low: Share
    high: Share
    recipe: _Hash


class CollectionIndex(StrictModel):
    """Index of a collection, the file `designs.json`.

    Attributes
    ----------
    schema_version : int
        Version of the format.
    designs : dict of str to Published
        By name.
    """

    schema_version: Literal[1] = 1
    designs: dict[DesignName, PublishedDesign] = Field({})

    @classmethod
    def read(cls, folder: Path) -> "CollectionIndex":
        """Index in a folder."""
        path = folder / INDEX_NAME
        content = read_text(path, LARGEST_INDEX, "give the folder of a collection of designs")
        with as_input_error(str(path), "make the collection again", content):
            return cls.model_validate_json(content)


def find_design(given: str | os.PathLike[str]) -> Path:
    """Path of a design file: the one that was given, or that of a published design by its name.

    A name has no ending and no separator, and nothing is at that path. It is looked for in the
    folder or at the address that the environment variable `DEEPFSI_DESIGNS` gives (`http`, `https`,
    `file`), and then among the designs that come with the package. Files of an address are kept in
    the user's cache.
    """
    name = os.fspath(given)
    path = Path(given)
    if path.exists():
        return path
    if path.name and (longer := path.with_name(f"{path.name}.safetensors")).is_file():
        raise InputError(f"no design file at {name}: did you mean {longer}?")
    if not re.fullmatch(NAME_PATTERN, name):
        return path
    collections = read_indexes()
    where = next((at for at, designs in collections.items() if name in designs), None)
    if where is None:
        names = [name for designs in collections.values() for name in designs]
        raise InputError(
            f"no design file and no published design {name!r}: {closest_choice(name, names)}; "
            f"make a file with `deepfsi design`, or set {DESIGNS_VARIABLE} to the folder or "
            "address of a collection"
        )
    folder = _folder(where)
    sha256 = collections[where][name].sha256
    if folder is None:
        path = cache_folder("designs") / f"{name}-{sha256[:12]}.safetensors"
        _fetch(f"{where}/{name}.safetensors", path, f"sha256:{sha256}")
        return path
    path = folder / f"{name}.safetensors"
    if hash_file(path) != sha256:
        raise InputError(
            f"{path} is not the file that {INDEX_NAME} beside it names (wrong sha256), changed or "
            "damaged: copy the original, or make it again with `deepfsi designs make`"
        )
    return path


def read_indexes() -> dict[str, dict[str, PublishedDesign]]:
    """Designs by name, of the collection of `DEEPFSI_DESIGNS` if it is set, and of the package's.

    The collections go by their folder or address.
    """
    found = {}
    if where := os.environ.get(DESIGNS_VARIABLE, "").rstrip("/"):
        found[where] = _read_index(where)
    return {**found, str(SHIPPED_DESIGNS): CollectionIndex.read(SHIPPED_DESIGNS).designs}


def _read_index(where: str) -> dict[str, PublishedDesign]:
    folder = _folder(where)
    if folder is not None:
        return CollectionIndex.read(folder).designs
    with TemporaryDirectory() as there:
        _fetch(f"{where}/{INDEX_NAME}", Path(there, INDEX_NAME))
        return CollectionIndex.read(Path(there)).designs


def _folder(where: str) -> Path | None:
    """Folder of a collection; None at an address of the web."""
    if "://" not in where:
        return Path(where).expanduser()
    scheme, _, path, *_ = urlsplit(where)
    if scheme == "file":
        return Path(url2pathname(path))
    if scheme not in ("http", "https"):
        raise InputError(
            f"{DESIGNS_VARIABLE} is '{where}': give a folder, or an address of http, https or file"
        )
    return None


def _fetch(url: str, path: Path, expected: str | None = None) -> None:
    """Download a file with a hash, unless it is there whole."""
    if failure := fetch(url, expected, path):
        raise InputError(
            f"cannot download {url} ({failure}), and nothing of it was kept: try again, or set "
            f"{DESIGNS_VARIABLE} to another address or to a folder"
        )
