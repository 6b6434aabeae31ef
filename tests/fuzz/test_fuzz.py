"""No mutated file makes a reader fail otherwise than with one line, hang, or take much memory.

`DEEPFSI_FUZZ` inputs are read, 10 000 unless given, from the seed `DEEPFSI_FUZZ_SEED`, 0 unless
given. A failure names its reader and seed: `python -m fuzz.worker SAMPLES WORK SEED 1 READER`.
"""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.readers import READERS

INPUTS, SEED = (int(os.environ.get(name, usual)) for name, usual in
                (("DEEPFSI_FUZZ", 10_000), ("DEEPFSI_FUZZ_SEED", 0)))  # fmt: skip

ROUNDS = math.ceil(INPUTS / sum(reader.weight for reader in READERS.values()))
"""Inputs of a reader of weight 1."""

SLOW = ["report", "report's design"]
"""Readers that draw figures: few inputs."""

FAST = [name for name in READERS if name not in SLOW]
GROUPS = [*((ROUNDS, FAST[first::2]) for first in range(2)), (min(ROUNDS, 12), SLOW)]
"""Readers that share a process, and their rounds."""


def faults_of(samples: Path, work: Path, first: int, count: int, names: list[str]) -> list[str]:
    """What goes wrong with inputs of these readers, in a process of its own."""
    words = [str(each) for each in (samples, work, first, count)]
    done = subprocess.run(
        [sys.executable, "-m", "fuzz.worker", *words, *names],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "MPLBACKEND": "Agg"},
    )
    found = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode:  # the process died of an input
        now = (work / "now").read_text() if (work / "now").is_file() else "no input"
        found.append(json.dumps({"reader": now, "fault": done.stderr[-2000:]}))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("group", range(len(GROUPS)))
def test_readers_refuse_what_they_cannot_read(group, samples, tmp_path):
    rounds, names = GROUPS[group]
    assert not faults_of(samples, tmp_path, SEED, rounds, names)
