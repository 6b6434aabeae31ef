"""Reads mutated files, in a process of its own, and says of each that is not refused with a line.

    python -m fuzz.worker SAMPLES WORK FIRST COUNT READER...

prints a JSON object for each failure, and keeps the input that is read in WORK/now.
"""

import json
import math
import re
import resource
import signal
import sys
import traceback
import warnings
from pathlib import Path
from types import FrameType

from deepfsi.base.errors import InputError
from fuzz.readers import READERS, copied, drawn

MOST_S = 20
"""Processor time of an input at most, seconds."""

MOST_BYTES = 2**30
"""Memory of an input at most."""


class Hang(BaseException):
    """An input takes longer than `MOST_S`."""


def _hang(signum: int, frame: FrameType | None) -> None:
    raise Hang


def _status(field: str) -> int:
    """Bytes of a field of the process's memory."""
    found = re.search(rf"{field}:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found
    return 1024 * int(found[1])


def fault_of(name: str, path: Path, most_bytes: float = MOST_BYTES) -> str:
    """What goes wrong with a file; empty where it is read or refused as it should be."""
    usual = signal.signal(signal.SIGPROF, _hang)
    signal.setitimer(signal.ITIMER_PROF, MOST_S)
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
    before = _status("VmRSS")
    try:
        READERS[name].read(path)
    except InputError as error:
        if "\n" in str(error) or len(str(error)) > 5000:
            return f"a message of several lines, or long: {str(error)[:300]!r}"
    except Hang:
        return "a hang: " + "".join(traceback.format_exc().splitlines()[-8:-1])
    except Exception:
        return "".join(traceback.format_exc()[-1500:])
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, usual)
    used = _status("VmHWM") - before
    return f"{used / 1e6:.0f} MB" if used > most_bytes else ""


def main(samples: Path, work: Path, first: int, count: int, names: list[str]) -> None:
    """Read inputs of so many seeds of each reader."""
    warnings.simplefilter("ignore")
    places = {name: copied(samples, READERS[name], work / str(k)) for k, name in enumerate(names)}
    for name, path in places.items():
        READERS[name].read(path)  # the sample itself is sound, and what it imports is loaded
    limit = _status("VmSize") + 3 * MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    now = work / "now"
    for name, path in places.items():
        sound = path.read_bytes()
        for seed in range(first, first + math.ceil(count * READERS[name].weight)):
            content = drawn(READERS[name], seed, name, sound)
            path.write_bytes(content)
            now.write_text(f"{name} {seed}")
            if fault := fault_of(name, path):
                print(json.dumps({"reader": name, "seed": seed, "fault": fault}), flush=True)
        path.write_bytes(sound)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]), sys.argv[5:])
