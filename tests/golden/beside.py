"""Facts of the reference: the package of one commit, run beside this one in another process.

    python tests/golden/beside.py store [MODULE …]

writes `exact/` anew from the reference, for cases that are new. Nothing is ever stored from the
package that is tested.
"""

import contextlib
import functools
import importlib
import io
import json
import os
import platform
import subprocess
import sys
import tarfile
import tempfile
import traceback
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

REFERENCE = "fa3deae976ce05cfc1c32dbe71e112b5e93f04db"
"""Commit of the package with which floats and bytes are compared."""

HERE = Path(__file__).parent
EXACT = HERE / "exact"
CACHE = HERE.parents[1] / ".venv" / "reference"
"""Source of the reference, and its facts of each case, on this machine."""

MODULES = tuple(sorted(path.stem for path in HERE.glob("*_cases.py")))
"""Modules that have cases."""

TOLERANCE = 0.05
"""Relative error of a case's size on another processor.

Products are rounded to bfloat16, 2⁻⁹, where noise is above that. A training of a moment takes them
some ten steps further, each with two products forth and two back: 10 · 4 · 2⁻⁹ is 0.08 for errors
of one sign, and 0.012 for those of random ones. Four of these are 0.05.
"""


def cases(module: str) -> dict[str, Any]:
    """Cases of a module by name, those of real files only where these are."""
    content = importlib.import_module(f"golden.{module}")
    real = getattr(content, "REAL_CASES", {}) if os.environ.get("DEEPFSI_DATA") else {}
    return {**content.CASES, **real}


def facts(module: str, name: str) -> dict[str, Any]:
    """Facts of a case, run in a folder of its own: exact ones, bits, and sizes of the floats."""
    from golden.facts import parts
    from golden.sizes import sizes

    case = cases(module)[name]
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), version_of_the_files():
        value = case()
        exact, bits = parts(value)
    return json.loads(json.dumps({"exact": exact, "bits": bits, "sizes": sizes(value)}))


@contextlib.contextmanager
def version_of_the_files() -> Iterator[None]:
    """Let the package say the version that made the stored files, so that a release changes none.

    Files hold the version, and hashes of files hold it, too. It is read from the first folder of
    `sys.path` that has metadata of the package.
    """
    from golden.file_cases import MADE_BY

    with tempfile.TemporaryDirectory() as folder:
        about = Path(folder) / f"deepfsi-{MADE_BY}.dist-info"
        about.mkdir()
        text = f"Metadata-Version: 2.1\nName: deepfsi\nVersion: {MADE_BY}\n"
        (about / "METADATA").write_text(text)
        sys.path.insert(0, folder)
        try:
            yield
        finally:
            sys.path.remove(folder)


def to_be_stored(module: str, of_case: dict[str, Any]) -> Any:
    """What is stored of a case's facts: the exact ones, or of many only their hash and sizes."""
    exact = of_case["exact"]
    if not is_hashed(module):
        return exact
    return {key: [digest(one), of_case["sizes"][key]] for key, one in exact.items()}


def is_hashed(module: str) -> bool:
    """True if only hashes are stored of what is exact in a module's cases."""
    return getattr(importlib.import_module(f"golden.{module}"), "HASHED", False)


def digest(exact: Any) -> str:
    """Hash of exact facts."""
    return sha256(json.dumps(exact, sort_keys=True).encode()).hexdigest()[:16]


@functools.cache
def stored(module: str) -> dict[str, Any]:
    """What is stored of each case."""
    return json.loads((EXACT / f"{module}.json").read_text())


class Reference:
    """The reference in a process of its own, which starts when a case is not in the cache."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def facts(self, module: str, name: str) -> dict[str, Any] | None:
        """Facts of a case; None where the source of the reference is not at hand."""
        path = CACHE / module / _state(module) / f"{digest(name)}.json"
        if not path.exists():
            source = _source()
            if source is None:
                return None
            path.parent.mkdir(parents=True, exist_ok=True)
            text = self._ask(source, [module, name])
            with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False) as file:
                file.write(text)
            Path(file.name).rename(path)
        return json.loads(path.read_text())

    def close(self) -> None:
        """End its process."""
        if self._process is not None:
            self._process.communicate()
            self._process = None

    def _ask(self, source: Path, question: list[str]) -> str:
        if self._process is None:
            folders = [str(source / "src"), str(HERE.parent)]
            environment = {
                **os.environ,
                "PYTHONPATH": os.pathsep.join(folders),
                "OMP_NUM_THREADS": "1",
                "MPLBACKEND": "Agg",
                "COLUMNS": "80",
            }
            self._process = subprocess.Popen(
                [sys.executable, __file__, "serve"],
                env=environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(question) + "\n")
        process.stdin.flush()
        text = process.stdout.readline()
        if not text or "error" in json.loads(text):
            raise RuntimeError(f"the reference fails in {question}: {text and json.loads(text)}")
        return text


def serve() -> None:
    """Give facts of the cases whose module and name come in, a line each."""
    import deepfsi

    assert CACHE in Path(deepfsi.__file__).parents, deepfsi.__file__
    out, sys.stdout = sys.stdout, open(os.devnull, "w")  # noqa: SIM115
    for line in sys.stdin:
        module, name = json.loads(line)
        try:
            answer = facts(module, name)
        except Exception:
            answer = {"error": traceback.format_exc()}
        out.write(json.dumps(answer) + "\n")
        out.flush()


@functools.cache
def _state(module: str) -> str:
    """Hash of what the facts of the reference depend on."""
    import numpy
    import torch

    machine = [platform.machine(), _processor(), sys.version, numpy.__version__, torch.__version__]
    state = sha256(json.dumps([REFERENCE, *machine, os.environ.get("DEEPFSI_DATA")]).encode())
    shared = [path for path in HERE.glob("*.py") if path.stem not in (*MODULES, *APART)]
    for path in sorted([HERE / f"{module}.py", *shared, *(HERE / "inputs").rglob("*")]):
        if path.is_file():
            state.update(path.relative_to(HERE).as_posix().encode() + path.read_bytes())
    return state.hexdigest()[:16]


APART = ("__init__", "beside", "test_golden", "make_inputs")
"""Modules on which no fact depends."""


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line
    return platform.processor()


def _source() -> Path | None:
    """Source of the reference, taken from the repository's history once."""
    import filelock

    folder = CACHE / REFERENCE
    CACHE.mkdir(parents=True, exist_ok=True)
    with filelock.FileLock(CACHE / "source.lock"):
        if not folder.exists():
            words = ["git", "-C", str(HERE.parents[1]), "archive", REFERENCE, "src"]
            try:
                archived = subprocess.run(words, capture_output=True, check=False)
            except OSError:
                return None
            if archived.returncode:
                return None
            unpacked = Path(tempfile.mkdtemp(dir=CACHE))
            with tarfile.open(fileobj=io.BytesIO(archived.stdout)) as archive:
                archive.extractall(unpacked, filter="data")
            unpacked.rename(folder)
    return folder


def store(modules: list[str]) -> None:
    """Write what is stored of the cases of modules, from the reference."""
    reference = Reference()
    for module in modules or MODULES:
        content = {}
        for name in cases(module):
            of_case = reference.facts(module, name)
            if of_case is None:
                raise SystemExit(f"the history of this repository lacks {REFERENCE}")
            content[name] = to_be_stored(module, of_case)
        lines = {
            name: json.dumps(one, ensure_ascii=False, sort_keys=True)
            for name, one in sorted(content.items())
        }
        text = ",\n".join(f"{json.dumps(name)}: {one}" for name, one in lines.items())
        EXACT.mkdir(exist_ok=True)
        (EXACT / f"{module}.json").write_text(f"{{\n{text}\n}}\n")
    reference.close()


def differences(stored: Any, now: Any, path: str = "") -> list[str]:
    """Where facts differ. A message may name more options than it did."""
    if isinstance(stored, dict) and isinstance(now, dict):
        keys = [*stored, *(key for key in now if key not in stored)]
        return [
            line
            for key in keys
            for line in differences(
                stored.get(key, MISSING), now.get(key, MISSING), f"{path}/{key}"
            )
        ]
    if isinstance(stored, list) and isinstance(now, list):
        if path.endswith("/options") and set(stored) <= set(now):
            return []
        if len(stored) == len(now):
            pairs = zip(stored, now, strict=True)
            return [
                line for k, (a, b) in enumerate(pairs) for line in differences(a, b, f"{path}/{k}")
            ]
    return [] if stored == now else [f"{path}: {stored!r} became {now!r}"]


def hashes_only(content: Any) -> Any:
    """What is stored, without the sizes, which another processor may change."""
    if isinstance(content, list) and len(content) == 2 and isinstance(content[1], float):
        return content[0]
    return {k: hashes_only(v) for k, v in content.items()} if isinstance(content, dict) else content


def far_sizes(stored: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Where sizes of floats, beside hashes, are further from what is stored than `TOLERANCE`."""
    return [
        f"/{key}: size {size} became {now[key][1]}"
        for key, (_, size) in stored.items()
        if key in now and abs(size - now[key][1]) > TOLERANCE * abs(size)
    ]


MISSING = "missing"

if __name__ == "__main__":
    sys.path[0] = str(HERE.parent)
    if sys.argv[1] == "serve":
        serve()
    else:
        store(sys.argv[2:])
