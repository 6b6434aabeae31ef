"""Design files of every kind and age, read and written again byte by byte."""

import json
import struct
from collections.abc import Callable
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

import deepfsi
from deepfsi.design.file import file_of
from golden.facts import INPUTS, Cases, parts, refused_or
from golden.scenes import about, file_facts, opened

CASES = Cases()
MADE_BY = "0.2.0"
"""Version of the package that wrote the stored files, and those that it comes with."""

FOLDER = INPUTS / "files"
FILES = {path.stem: path for path in sorted(FOLDER.iterdir())}
"""Designs of each kind of exposure, light law and noise that files tell apart."""


@CASES.of(FILES)
def read(name: str) -> dict[str, Any]:
    """A design file, read and written again."""
    return _again(FILES[name], deepfsi.load_design(FILES[name]))


@CASES.of(("dmd-mnist", "adaptive-mnist"))
def shipped(name: str) -> dict[str, Any]:
    """A design that comes with the package, by its name."""
    [path] = Path(str(files("deepfsi"))).rglob(f"{name}.safetensors")
    facts = _again(path, deepfsi.load_design(name))
    del facts["camera"]
    return facts


def _again(path: Path, design: Any) -> dict[str, Any]:
    again = Path(design.save("again.safetensors"))
    if deepfsi.__version__ == MADE_BY:
        same = path.read_bytes() == again.read_bytes()
    else:  # the reference of a release: but for the version that wrote it
        same = parts(file_facts(path)) == parts(file_facts(again))
    return {
        "hash": sha256(path.read_bytes()).hexdigest(),
        "same": same,
        "written": again.read_bytes(),
        **about(design),
    }


CHANGES: dict[str, Callable[[dict[str, Any]], Any]] = {
    "unchanged": lambda d: None,
    "no camera": lambda d: d["info"]["job"].pop("camera"),
    "no stretch": lambda d: d["info"]["job"]["camera"].pop("stretch"),
    "no job": lambda d: d["info"].pop("job"),
    "no data": lambda d: d["info"].pop("data"),
    "newer": lambda d: d.update(schema=2),
    "unversioned": lambda d: d.update(schema="1"),
    "strange": lambda d: d.update(strange=1),
    "other light": lambda d: d.update(light="moon"),
}
"""Descriptions of other versions, beside those without one of their fields."""


@CASES.of(FILES)
def older(name: str) -> dict[str, Any]:
    """A design file without each field, of other versions, and damaged."""
    content = FILES[name].read_bytes()
    word, described, layout, tensors = opened(content)

    def edited(change: Callable[[dict[str, Any]], Any]) -> bytes:
        header = json.loads(json.dumps(described))
        change(header)
        text = json.dumps({**layout, "__metadata__": {word: json.dumps(header)}}).encode()
        text += b" " * (-len(text) % 8)
        return struct.pack("<Q", len(text)) + text + tensors

    def written(change: bytes) -> Any:
        Path("changed.safetensors").write_bytes(change)
        return refused_or(lambda: file_of(deepfsi.load_design("changed.safetensors")).to_bytes())

    return {
        **{f"no {field}": written(edited(lambda d, f=field: d.pop(f))) for field in described},
        **{name: written(edited(change)) for name, change in CHANGES.items()},
        "cut": written(content[:-5]),
        "longer": written(content + b"1234"),
        "empty": written(b""),
        "no header": written(content[8:]),
    }
