"""Facts of the reference: the package of one commit, run beside this one in another process.

    python tests/golden/beside.py [MODULE …]

adds what the reference gives on this processor to `known.json`, as a hash for each case that gives
other facts: facts with such a hash are the reference's, which then need not run. A case with a fact
that differs is never stored. Keys of facts whose subject left the package stand in `LEFT`.
"""

import contextlib
import functools
import importlib
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from hashlib import sha256
from importlib import metadata
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

REFERENCE = "d450720292638aeccef2f96954776d1cab7c9ce7"
"""Commit of the package with which floats and bytes are compared."""

LEFT: frozenset[str] = frozenset()
"""Keys of facts that the reference has and this package no longer: what they told left."""

HERE = Path(__file__).parent
CACHE = HERE.parents[1] / ".venv" / "reference"
"""Source of the reference, and its facts of each case, on this machine."""

KNOWN = HERE / "known.json"
"""Hashes of the reference's facts of each case, one for each kind of processor that gave them."""

MODULES = tuple(sorted(path.stem for path in HERE.glob("*_cases.py")))
"""Modules that have cases."""

APART = ("__init__", "beside", "test_golden")
"""Modules on which no fact depends."""


def content_of(module: str) -> Any:
    return importlib.import_module(f"golden.{module}")


def cases(module: str) -> dict[str, Any]:
    """Cases of a module by name, those of real files only where these are."""
    real = getattr(content_of(module), "REAL_CASES", {}) if os.environ.get("DEEPFSI_DATA") else {}
    return {**content_of(module).CASES, **real}


def facts(module: str, name: str) -> dict[str, Any]:
    """Facts of a case, run in a folder of its own: exact ones and bits."""
    from golden.facts import parts

    case = cases(module)[name]
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), version_of_the_files():
        exact, bits = parts(case())
    return json.loads(json.dumps({"exact": exact, "bits": bits}))


def version_of_the_files() -> Any:
    """Let the package say the version that made the stored files, so that a release changes none.

    Files hold the version, and hashes of files hold it, too.
    """
    from golden.file_cases import MADE_BY

    usual = metadata.distribution

    def distribution(name: str) -> Any:
        return SimpleNamespace(version=MADE_BY) if name == "deepfsi" else usual(name)

    return mock.patch.object(metadata, "distribution", distribution)


def digest(exact: Any) -> str:
    """Hash of exact facts."""
    return sha256(json.dumps(exact, sort_keys=True).encode()).hexdigest()[:16]


Ask = Any
"""Gives the facts of a case, `(module, name)`; None where the reference is not at hand."""


@contextlib.contextmanager
def reference() -> Iterator[Ask]:
    """Give who is asked for facts of the reference, which starts when one is not in the cache."""
    source = _source()
    if source is None:
        yield lambda module, name: None
        return
    spawned = get_context("spawn")
    with ProcessPoolExecutor(1, spawned, _be_reference, (str(source / "src"),)) as process:

        def ask(module: str, name: str) -> dict[str, Any]:
            path = CACHE / module / _state(module) / f"{digest(name)}.json"
            if not path.exists():
                path.parent.mkdir(parents=True, exist_ok=True)
                text = json.dumps(process.submit(facts, module, name).result())
                with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False) as file:
                    file.write(text)
                Path(file.name).rename(path)
            return json.loads(path.read_text())

        yield ask


def _be_reference(source: str) -> None:
    """Import the reference in this process, and in those that it starts."""
    sys.path[:0] = [source, str(HERE.parent)]
    os.environ |= {"PYTHONPATH": os.pathsep.join(sys.path[:2]), "MPLBACKEND": "Agg"}
    os.environ |= {"OMP_NUM_THREADS": "1", "COLUMNS": "80"}
    sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    import deepfsi

    assert CACHE in Path(deepfsi.__file__).parents, deepfsi.__file__


@functools.cache
def _state(module: str) -> str:
    """Hash of what the facts of the reference depend on."""
    import numpy
    import torch

    about = Path("/proc/cpuinfo")
    processor = re.findall("model name.*", about.read_text())[:1] if about.exists() else []
    processor += [platform.machine(), platform.processor()]
    machine = [*processor, sys.version, numpy.__version__, torch.__version__]
    state = sha256(json.dumps([REFERENCE, *machine, os.environ.get("DEEPFSI_DATA")]).encode())
    shared = [path for path in HERE.glob("*.py") if path.stem not in (*MODULES, *APART)]
    for path in sorted([HERE / f"{module}.py", *shared, *(HERE / "inputs").rglob("*")]):
        if path.is_file():
            state.update(path.relative_to(HERE).as_posix().encode() + path.read_bytes())
    return state.hexdigest()[:16]


@functools.cache
def known() -> dict[str, Any]:
    """Of each module and case the hashes of the facts that the reference gave."""
    content = json.loads(KNOWN.read_text())
    return content["cases"] if content["reference"] == REFERENCE else {}


def is_known(module: str, name: str, of_case: dict[str, Any]) -> bool:
    """True if facts are, bit for bit, what the reference gave on one of the known processors."""
    return fingerprint(of_case) in known().get(module, {}).get(name, "").split()


def fingerprint(of_case: dict[str, Any]) -> str:
    """Hash of the facts of a case, bits included."""
    return digest([of_case["exact"], of_case["bits"]])


def know(modules: list[str]) -> None:
    """Add what the reference gives on this processor to the known hashes; cases that left go."""
    content = {"reference": REFERENCE, "cases": dict(known())}
    with reference() as ask:
        for module in modules or MODULES:
            hashes = {}
            for name in sorted(cases(module)):
                hashes[name] = known().get(module, {}).get(name, "")
                now = facts(module, name)
                if not is_known(module, name, now):
                    wrong = differences(ask(module, name), now)
                    for line in wrong:
                        print(f"{module} {name}: {line[:100]}")
                    if not wrong:
                        hashes[name] = f"{hashes[name]} {fingerprint(now)}".strip()
            content["cases"][module] = hashes
    KNOWN.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def _source() -> Path | None:
    """Source of the reference, taken from the repository's history once; None without it."""
    import filelock

    folder = CACHE / REFERENCE
    CACHE.mkdir(parents=True, exist_ok=True)
    with filelock.FileLock(CACHE / "source.lock"):
        if not folder.exists():
            words = ["git", "-C", str(HERE.parents[1]), "archive", REFERENCE, "src"]
            try:
                archived = subprocess.run(words, capture_output=True, check=True)
            except (OSError, subprocess.CalledProcessError):
                return None
            unpacked = Path(tempfile.mkdtemp(dir=CACHE))
            subprocess.run(["tar", "-xC", unpacked], input=archived.stdout, check=True)
            unpacked.rename(folder)
    return folder


def differences(before: Any, now: Any, path: str = "") -> list[str]:
    """Where facts differ. A message may name more options than it did."""
    lists = isinstance(before, list) and isinstance(now, list)
    if lists and path.endswith("/options") and set(before) <= set(now):
        return []
    if lists and len(before) == len(now):
        before, now = dict(enumerate(before)), dict(enumerate(now))
    if isinstance(before, dict) and isinstance(now, dict):
        kept = [key for key in before if key in now or key not in LEFT]
        keys = [*kept, *(key for key in now if key not in before)]
        pairs = ((key, before.get(key, "missing"), now.get(key, "missing")) for key in keys)
        return [line for key, a, b in pairs for line in differences(a, b, f"{path}/{key}")]
    return [] if before == now else [f"{path}: {before!r} became {now!r}"]


if __name__ == "__main__":
    sys.path[0] = str(HERE.parent)
    importlib.import_module("golden.beside").know(sys.argv[1:])
