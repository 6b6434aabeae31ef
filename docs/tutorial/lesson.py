"""Beginning of each page of the tutorial: pictures in place of your own, and its command lines."""

import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from sklearn.datasets import load_digits

from deepfsi.datasets import write_pictures


def write_digits(folder: Path) -> None:
    """Write 1797 handwritten digits of 8 × 8 pixels, a sub-folder for each class."""
    digits = load_digits()
    named = enumerate(zip(digits.images, digits.target, strict=True))
    images = {f"{label}/{number:04d}.png": image / 16 for number, (image, label) in named}
    write_pictures(images, folder)


def commands_in(folder: Path) -> Callable[[str], None]:
    """Make a function that runs a command line in a folder, and prints it with its output."""

    def run(line: str) -> None:
        words = [sys.executable, "-m", *shlex.split(line.replace("\\\n", ""))]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=True)
        print(f"$ {line}\n{done.stdout}")

    return run
