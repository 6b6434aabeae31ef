"""No mutated file makes a reader fail otherwise than with one line, hang, or take much memory.

`DEEPFSI_FUZZ` inputs are read, 750 unless given, from the seed `DEEPFSI_FUZZ_SEED`, 0 unless
given. A failure names its reader and seed: `python -m fuzz.worker SAMPLES WORK SEED 1 READER`.
"""

import math
import os
import subprocess
import sys

import pytest

from fuzz.readers import READERS

INPUTS = int(os.environ.get("DEEPFSI_FUZZ", 750))
SEED = os.environ.get("DEEPFSI_FUZZ_SEED", "0")
ROUNDS = math.ceil(INPUTS / sum(reader.weight for reader in READERS.values()))
"""Inputs of a reader of weight 1."""


@pytest.mark.slow
def test_readers_refuse_what_they_cannot_read(samples, tmp_path):
    """In a process of its own, which may die of an input."""
    words = [sys.executable, "-m", "fuzz.worker", samples, tmp_path, SEED, str(ROUNDS), *READERS]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "MPLBACKEND": "Agg"}
    done = subprocess.run(words, capture_output=True, text=True, env=environment)
    last = tmp_path / "now"
    assert not done.returncode, (last.is_file() and last.read_text(), done.stderr[-2000:])
    assert not [line for line in done.stdout.splitlines() if line.startswith("{")]
