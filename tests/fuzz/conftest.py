"""Samples of all readers, made once for all processes that test."""

import os
from pathlib import Path

import pytest
from filelock import FileLock

from fuzz.readers import make_samples


@pytest.fixture(scope="session")
def samples(tmp_path_factory) -> Path:
    base, run = tmp_path_factory.getbasetemp(), os.environ.get("PYTEST_XDIST_TESTRUNUID")
    folder = base.parent / f"samples-{run}" if run else base / "samples"
    with FileLock(f"{folder}.lock"):
        if not (folder / "made").exists():
            folder.mkdir()
            make_samples(folder)
            (folder / "made").touch()
    return folder
