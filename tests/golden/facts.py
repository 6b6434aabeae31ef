"""What cases are made of: a command line's answer, stored inputs, and facts that can be compared.

Runs in two packages, of now and of the reference, so it knows the command line and no module.
"""

import contextlib
import io
import json
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

INPUTS = Path(__file__).parent / "inputs"
DATA = Path(os.environ.get("DEEPFSI_DATA") or "nowhere")
"""Real files of the user; without them their cases are left out."""


class Cases(dict[str, Callable[[], dict[str, Any]]]):
    """Cases of a module by their names, which are those of their functions."""

    def __call__(self, case: Callable[[], Any]) -> Callable[[], Any]:
        self[case.__name__.replace("_", " ")] = case
        return case

    def of(self, names: Iterable[str]) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        """Make a case of each name, which is what the function gets."""

        def add(case: Callable[..., Any]) -> Callable[..., Any]:
            kind = case.__name__.replace("_", " ")
            self.update({f"{kind} {name}": partial(case, name) for name in names})
            return case

        return add


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
        options = sorted({*re.findall(r"(?<![\w-])--[a-z][a-z-]*", " ".join(lines))} - {"--help"})
        printed = bool(self.out)
        return {"code": self.code, "lines": len(lines), "printed": printed, "options": options}


def say(*words: object) -> Said:
    """Run a command line in this process."""
    from deepfsi import cli

    out, errors = io.StringIO(), io.StringIO()
    before, sys.argv = sys.argv, ["deepfsi", *map(str, words)]
    code: Any = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
            cli.run_command_line()
    except SystemExit as stop:
        code = stop.code or 0
    finally:
        sys.argv = before
    return Said(code, out.getvalue(), errors.getvalue())


def answer(*words: object) -> Any:
    """JSON of a command line that may be refused, cleaned."""
    said = say(*words, "--json")
    return cleaned(said.json) if said.code == 0 else said.refused()


WORDS = ("detail", "warnings", "remarks", "refusal", "problems", "notes")
"""Fields whose text may become better: of these the numbers are compared."""


def cleaned(value: Any) -> Any:
    """JSON without where files are, and without the words of faults and remarks."""
    if isinstance(value, dict):
        return {key: _numbers(one) if key in WORDS else cleaned(one) for key, one in value.items()}
    if isinstance(value, str):
        for path, name in ((INPUTS, "INPUTS"), (DATA, "DATA"), (os.getcwd(), "HERE")):
            value = value.replace(str(path), name)
    return [cleaned(one) for one in value] if isinstance(value, list) else value


def _numbers(value: Any) -> Any:
    if isinstance(value, str):
        return [float(number) for number in re.findall(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?", value)]
    return [_numbers(one) for one in value] if isinstance(value, list) else value


TIMES = ("seconds", "training_seconds", "finished", "machine")
VERSIONS = ("version", "deepfsi", "torch", "python", "numpy")
ANSWERS = ("confusion", "terms", "worst_class", "best")
"""Fields that follow the last bits of a network: compared with the reference alone."""


def timeless(value: Any) -> Any:
    """Without what depends on when and where it ran."""
    if isinstance(value, dict):
        return {
            key: json.dumps(one).encode() if key in ANSWERS else timeless(one)
            for key, one in value.items()
            if key not in (*TIMES, *VERSIONS)
        }
    return [timeless(one) for one in value] if isinstance(value, list) else value


def refused_or(make: Callable[[], Any]) -> Any:
    """Facts of what is made, or that it is refused in one line."""
    from deepfsi import InputError

    try:
        return make()
    except InputError as error:
        lines = str(error).splitlines()
        assert len(lines) == 1, lines
        return {"refused": True}


def plain(value: Any) -> Any:
    """Fields of a result that are numbers, words or arrays."""
    if hasattr(value, "detach"):
        return value.detach().cpu().numpy()
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, dict):
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    if isinstance(value, np.generic):
        return value.item()
    return value if isinstance(value, (str, int, float, np.ndarray, type(None))) else {}


def parts(value: Any) -> tuple[Any, dict[str, str]]:
    """Facts without their floats, and those bit for bit, by where they stand.

    Long lists of numbers, arrays and bytes are hashed; bytes are compared as floats are.
    """
    bits: dict[str, str] = {}
    return _without_floats(value, "", bits), bits


MOST_LISTED = 6
"""Numbers of a list that are stored one by one."""


LEFT = ("auc", "auc_low", "auc_high", "AUC", "differences", "rmse_low", "rmse_high", "bound")
"""Keys that the reference gives, of what left."""


def _without_floats(value: Any, place: str, bits: dict[str, str]) -> Any:
    if isinstance(value, bytes):
        bits[place] = sha256(value).hexdigest()[:16]
        return "bytes"
    if isinstance(value, list):
        with contextlib.suppress(ValueError):  # of lists that differ in length
            array = np.array(value)
            value = array if array.dtype.kind in "iufb" and array.size > MOST_LISTED else value
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
        return {
            key: _without_floats(one, f"{place}/{key}", bits)
            for key, one in value.items()
            if key not in LEFT
        }
    if isinstance(value, (list, tuple)):
        return [_without_floats(one, f"{place}/{k}", bits) for k, one in enumerate(value)]
    return value


def files(folder: Path | str, *left_out: str) -> dict[str, bytes]:
    """Bytes of every file of a folder, by its path in it."""
    folder = Path(folder)
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in left_out
    }


def arrays(path: Path | str) -> dict[str, Any]:
    """Arrays of an .npz file; text holds floats, so that it is given as bytes."""
    with np.load(path) as file:
        content = {name: file[name] for name in file.files}
    return {name: one.tobytes() if one.dtype == np.uint8 else one for name, one in content.items()}


def file_of(design: str) -> Path:
    return INPUTS / "designs" / f"{design}.safetensors"


def recording(name: str, design: str, folder: str = "run") -> str:
    """A stored run, put into a folder with the design whose patterns it showed."""
    shutil.copytree(INPUTS / "recordings" / name, folder)
    Path(folder, "calibration").mkdir(exist_ok=True)
    shutil.copy(file_of(design), Path(folder, "patterns", "design.safetensors"))
    return folder


def patterns_of(design: str) -> str:
    """Patterns of a stored design on a small device, in the folder of its name."""
    folder = f"patterns-{design}"
    device = INPUTS / "loading.toml" if "adaptive" in design else "64x48"
    words = ("--dmd", device, "--exposure", "10ms", "-o", folder)
    said = say("dmd", "export", file_of(design), *words)
    assert said.code == 0, said.errors
    return folder
