"""What a command line gave, as facts that can be compared.

Runs in two packages, of now and of the reference, so it knows the command line and no module.
"""

import contextlib
import io
import json
import os
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

INPUTS = Path(__file__).parent / "inputs"
"""Stored designs, recordings, tables and pictures; `make_inputs.py` says how they were made."""

DATA = Path(os.environ.get("DEEPFSI_DATA") or "nowhere")
"""Real files of the user; without them their cases are left out."""

Case = Callable[[], dict[str, Any]]

OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?")


@dataclass(frozen=True)
class Said:
    """What a command line printed, and its exit code."""

    code: int
    out: str
    errors: str

    @property
    def json(self) -> Any:
        assert self.code == 0, self.errors
        return json.loads(self.out)

    def refused(self) -> dict[str, Any]:
        """Exit code, number of lines, and the options that the line names; its words may change.

        That it also leads to the command's help is left out.
        """
        lines = [line for line in self.errors.splitlines() if line.startswith("deepfsi: ")]
        options = sorted(set(OPTION.findall(" ".join(lines))) - {"--help"})
        printed = bool(self.out)
        return {"code": self.code, "lines": len(lines), "printed": printed, "options": options}


def say(*words: object) -> Said:
    """Run a command line in this process."""
    from deepfsi import cli

    run = getattr(cli, "run_command_line", None) or cli.main  # as the reference has it
    out, errors = io.StringIO(), io.StringIO()
    before, sys.argv = sys.argv, ["deepfsi", *map(str, words)]
    code: Any = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
            run()
    except SystemExit as stop:
        code = stop.code or 0
    finally:
        sys.argv = before
    return Said(code, out.getvalue(), errors.getvalue())


def answer(*words: object) -> Any:
    """JSON of a command line that may be refused; the words of faults and remarks are left out."""
    said = say(*words, "--json")
    return without_words(said.json) if said.code == 0 else said.refused()


WORDS = ("detail", "warnings", "remarks", "refusal", "problems", "notes")
"""Fields whose text may become better: of these the numbers are compared."""


def without_words(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            key: _numbers(one) if key in WORDS else without_words(one) for key, one in value.items()
        }
    if isinstance(value, list):
        return [without_words(one) for one in value]
    return value


def _numbers(value: Any) -> Any:
    if isinstance(value, str):
        return [float(number) for number in NUMBER.findall(value)]
    return [_numbers(one) for one in value] if isinstance(value, list) else value


def without_paths(value: Any) -> Any:
    """Without where inputs, real files and the current folder are."""
    if isinstance(value, dict):
        return {key: without_paths(one) for key, one in value.items()}
    if isinstance(value, list):
        return [without_paths(one) for one in value]
    if isinstance(value, str):
        for path, name in ((INPUTS, "INPUTS"), (DATA, "DATA"), (os.getcwd(), "HERE")):
            value = value.replace(str(path), name)
    return value


TIMES = (
    "seconds",
    "training_seconds",
    "finished",
    "version",
    "deepfsi",
    "torch",
    "machine",
    "python",
    "numpy",
)


def without_times(value: Any) -> Any:
    """Without what depends on when and where it ran."""
    if isinstance(value, dict):
        return {key: without_times(one) for key, one in value.items() if key not in TIMES}
    return [without_times(one) for one in value] if isinstance(value, list) else value


def parts(value: Any) -> tuple[Any, dict[str, str]]:
    """Facts without their floats, and those bit for bit, by where they stand.

    Long lists of numbers, arrays and bytes are hashed; bytes are compared as floats are.
    """
    bits: dict[str, str] = {}
    return _without_floats(value, "", bits), bits


MOST_LISTED = 6
"""Numbers of a list that are stored one by one."""


def _without_floats(value: Any, place: str, bits: dict[str, str]) -> Any:
    if isinstance(value, bytes):
        bits[place] = sha256(value).hexdigest()[:16]
        return "bytes"
    if isinstance(value, list) and _is_long(value):
        value = np.array(value)
    if isinstance(value, np.ndarray):
        said = f"{value.dtype.kind}{list(value.shape)}"
        digest = sha256(np.ascontiguousarray(value).tobytes()).hexdigest()[:16]
        if value.dtype.kind in "iub":
            return f"{said} {digest}"
        bits[place] = digest
        return said
    if isinstance(value, (float, np.floating)):
        bits[place] = float(value).hex()
        return "float"
    if isinstance(value, dict):
        return {key: _without_floats(one, f"{place}/{key}", bits) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_floats(one, f"{place}/{k}", bits) for k, one in enumerate(value)]
    return value


def _is_long(value: list[Any]) -> bool:
    """True of a long list of numbers, or of lists of numbers of one shape."""
    try:
        array = np.array(value)
    except ValueError:
        return False
    return array.dtype.kind in "iufb" and array.size > MOST_LISTED


def files(folder: Path | str, *left_out: str) -> dict[str, bytes]:
    """Bytes of every file of a folder, by its path in it."""
    folder = Path(folder)
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in left_out
    }


def arrays(path: Path | str) -> dict[str, np.ndarray]:
    """Arrays of an .npz file."""
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def recording(name: str, design: str, folder: str = "run") -> str:
    """A stored run, put into a folder with the design whose patterns it showed."""
    shutil.copytree(INPUTS / "recordings" / name, folder)
    Path(folder, "calibration").mkdir(exist_ok=True)
    shutil.copy(file_of(design), Path(folder, "patterns", "design.safetensors"))
    return folder


def file_of(design: str) -> Path:
    return INPUTS / "designs" / f"{design}.safetensors"


def patterns_of(design: str, *words: object) -> str:
    """Patterns of a stored design on a small device, in the folder of its name."""
    folder = f"patterns-{design}"
    if not Path(folder).exists():
        device = INPUTS / "loading.toml" if "adaptive" in design else "64x48"
        words = ("--device", device, "--exposure", "10ms", *words)
        said = say("dmd", "export", file_of(design), *words, "-o", folder)
        assert said.code == 0, said.errors
    return folder
