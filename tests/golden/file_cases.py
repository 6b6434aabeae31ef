"""Design files of every kind and age, read and written again byte by byte.

`inputs/files` holds designs of the reference, `python tests/golden/file_cases.py` makes them. A
case is a function without parameters that gives facts as `facts.parts` takes them.
"""

import json
import struct
from collections.abc import Callable
from functools import partial
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

import deepfsi
from golden.facts import INPUTS, parts
from golden.scenes import BUDGET, STEPS, digits, file_facts, refused_or, spots

Case = Callable[[], dict[str, Any]]

FOLDER = INPUTS / "files"

MADE_BY = "0.2.0"
"""Version of the package that wrote the stored files, and those that it comes with."""

JOBS: dict[str, dict[str, Any]] = {
    "fixed": {"camera": "dmd"},
    "column": {"camera": "paper"},
    "two-arm": {"camera": "two-arm"},
    "detectors": {"camera": "dmd-2x2"},
    "clicks": {"camera": {"noise": "click", "gates": 50}},
    "device": {"camera": {"device": "64x48", "exposure": "10ms", "flux": 1e6, "dark": 100.0}},
    "range": {"camera": "dmd", "exposure": {"span": 10}},
    "nested": {"camera": "dmd", "exposure": {"nested": 2}},
    "looks": {"camera": "two-arm", "exposure": {"looks": 2}},
    "patches": {
        "camera": "paper",
        "exposure": {"patch": 4},
        "training": {
            "epochs": 1,
            "batch": 45,
            "classifier_arguments": {"width": 8, "depth": 1, "heads": 2, "hidden": 8},
        },
    },
    "passing": {"masks": None, "exposure": {"bins": 6, "jitter": 0.5}},
    "network": {
        "training": {"epochs": 1, "batch": 30, "classifier": "golden.parts:network"},
    },
    "values": {"camera": "dmd"},
    "adaptive": {"design": "adaptive", "masks": 3, "training": {"clusters": 2}},
    "characterised": {"camera": "dmd"},
}
"""Jobs of the stored files."""


def make() -> None:
    """Write the stored files."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, job in JOBS.items():
        given = {"masks": 4, "photons": BUDGET, "training": STEPS, **job}
        given = {field: one for field, one in given.items() if one is not None}
        data = spots() if name == "values" else digits(600, classes=4)
        if name not in ("values", "characterised"):
            data = digits(120, classes=4).hold_out(9)
        deepfsi.learn(data, **given).save(FOLDER / f"{name}.safetensors")


def read(path: Path) -> dict[str, Any]:
    """A design file, read and written again."""
    content = path.read_bytes()
    design = deepfsi.load_design(path)
    again = design.save("again.safetensors")
    return {
        "hash": sha256(content).hexdigest(),
        "same": same(path, Path(again)),
        "written": Path(again).read_bytes(),
        "words": None if design.name == "adaptive" else repr(design),
        "camera": design.camera.model_dump(mode="json"),
    }


def same(path: Path, again: Path) -> bool:
    """True if a file was written again byte by byte, but for the version that wrote it."""
    if deepfsi.__version__ == MADE_BY:
        return path.read_bytes() == again.read_bytes()
    return parts(file_facts(path)) == parts(file_facts(again))


def edited(content: bytes, change: Callable[[dict[str, Any]], None]) -> bytes:
    """A design file whose description was changed."""
    (length,) = struct.unpack("<Q", content[:8])
    header = json.loads(content[8 : 8 + length])
    [(name, words)] = header["__metadata__"].items()
    described = json.loads(words)
    change(described)
    header["__metadata__"][name] = json.dumps(described)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return struct.pack("<Q", len(text)) + text + content[8 + length :]


def older(name: str) -> dict[str, Any]:
    """A design file without each field, of other versions, and damaged."""
    content = (FOLDER / f"{name}.safetensors").read_bytes()
    described: dict[str, Any] = {}
    edited(content, described.update)
    changes: dict[str, Callable[[dict[str, Any]], Any]] = {
        **{f"no {field}": lambda d, field=field: d.pop(field) for field in described},
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
    out: dict[str, Any] = {}
    for change, apply in changes.items():
        Path("changed.safetensors").write_bytes(edited(content, apply))
        out[change] = refused_or(lambda: _again("changed.safetensors"))
    for damage, damaged in {
        "cut": content[:-5],
        "longer": content + b"1234",
        "empty": b"",
        "no header": content[8:],
    }.items():
        Path("damaged.safetensors").write_bytes(damaged)
        out[damage] = refused_or(lambda: _again("damaged.safetensors"))
    return out


def _again(path: str) -> bytes:
    """Content of a file that is read and written again."""
    design = deepfsi.load_design(path)
    return Path(design.save("again.safetensors")).read_bytes()


def shipped(name: str) -> dict[str, Any]:
    """A design that comes with the package, by its name."""
    design = deepfsi.load_design(name)
    path = Path(design.save("again.safetensors"))
    [original] = Path(str(files("deepfsi"))).rglob(f"{name}.safetensors")
    return {
        "same": same(original, path),
        "written": path.read_bytes(),
        "hash": sha256(original.read_bytes()).hexdigest(),
        "words": None if design.name == "adaptive" else repr(design),
    }


CASES: dict[str, Case] = {
    **{f"read {name}": partial(read, FOLDER / f"{name}.safetensors") for name in JOBS},
    **{f"older {name}": partial(older, name) for name in JOBS},
    **{f"shipped {name}": partial(shipped, name) for name in ("dmd-mnist", "adaptive-mnist")},
}
HASHED = True

if __name__ == "__main__":
    make()
