"""A computer of a laboratory without torch, in a process of its own.

Reads command lines of `deepfsi` from standard input, runs each, and prints their exit codes. A
file that is opened as text without its encoding is an error. `.ci/camera.py` runs on Windows.
"""

import sys
import warnings


class Hidden:
    """Finder that has no such module."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        top = name.partition(".")[0]
        if top in self.names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=top)


def run(lines: list[str]) -> None:
    """Run commands, one after another."""
    from deepfsi.cli import run_command_line

    for line in lines:
        sys.argv = ["deepfsi", *line.split()]
        try:
            run_command_line()
        except SystemExit as stop:
            print(f"exit {stop.code or 0}: {line}", flush=True)


if __name__ == "__main__":
    sys.meta_path.insert(0, Hidden(("torch",)))
    warnings.filterwarnings("error", category=EncodingWarning, module=r"deepfsi\.")
    run(sys.stdin.read().splitlines())
