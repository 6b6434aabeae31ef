"""Numbers of trainings with fixed seeds: every design, light law and kind of exposure.

A change of the code that is meant to change no number is held against the numbers before it, to the
last digit, on one machine:

    python benchmarks/same_numbers.py > before.json
    python benchmarks/same_numbers.py --against before.json

Each case is a command line of `deepfsi design`. What is kept of it are the accuracies of its tests
and a hash of the masks, the network and its features, without what is found of a trained design
afterwards (`FOUND_AFTER`). MNIST is added where `DEEPFSI_DATA` names a folder with it.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from safetensors.numpy import load_file

FOUND_AFTER = ("distribution.", "temperatures.")
"""Begins of the names of tensors that no accuracy depends on."""

DIGITS = "--data digits --epochs 4 --photons 1e4 "
DMD = "--light free-dwell --rails single "
COLUMN = "--light column --rails dual "
CASES = {
    **{
        f"digits {name}": f"--design {name} {COLUMN}"
        for name in ("impulse", "raster", "hadamard", "s-matrix")
    },
    **{
        f"digits {name}": f"--design {name} --masks 8 {COLUMN}"
        for name in ("truncated-hadamard", "pca", "lda", "class-pairs", "random", "control")
    },
    "digits column": "--masks 8 " + COLUMN,
    "digits gaussian": "--masks 8 --noise gaussian " + COLUMN,
    "digits camera": "--masks 8 --noise camera --dark 50 " + COLUMN,
    "digits camera pca": "--design pca --masks 8 --noise camera --dark 50 " + DMD,
    "digits none": "--masks 8 --noise none " + COLUMN,
    "digits free-dwell": "--masks 8 " + DMD,
    "digits free-dwell dual": "--masks 8 --light free-dwell --rails dual",
    "digits equal-dwell": "--masks 8 --light equal-dwell --rails dual",
    "digits two-arm": "--masks 8 --light two-arm --rails dual",
    "digits detectors": "--masks 6 --detectors 2x2 " + DMD,
    "digits detectors pca": "--masks 6 --design pca --detectors 2x2 " + DMD,
    "digits range": "--masks 8 --photons 1e3:1e5 " + COLUMN,
    "digits range pca": "--masks 8 --design pca --photons 1e3:1e5 " + DMD,
    "digits levels": "--masks 8 --levels 2 " + DMD,
    "digits levels pca": "--masks 8 --levels 4 --design pca " + COLUMN,
    "digits counts": "--masks 8 --counts 300 " + COLUMN,
}
MNIST = "--data mnist --epochs 2 --photons 1e4 "
MNIST_CASES = {
    "mnist pca": "--design pca --masks 10 " + COLUMN,
    "mnist column": "--masks 10 " + COLUMN,
    "mnist free-dwell": "--masks 10 " + DMD,
    "mnist range": "--masks 10 --photons 1e3:1e5 " + DMD,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--against", type=Path, help="numbers of before, JSON")
    before = parser.parse_args().against
    cases = {name: DIGITS + rest for name, rest in CASES.items()}
    if (Path(os.environ.get("DEEPFSI_DATA", "")) / "mnist").is_dir():
        cases |= {name: MNIST + rest for name, rest in MNIST_CASES.items()}
    found = {name: numbers(words) for name, words in cases.items()}
    print(json.dumps(found, indent=1))
    if before is not None:
        known = json.loads(before.read_text())
        differ = [name for name in found if name in known and found[name] != known[name]]
        new = found.keys() - known.keys()
        print(f"{len(found) - len(differ) - len(new)} cases alike", file=sys.stderr)
        if differ or new:
            sys.exit(f"differ: {', '.join(differ) or 'none'}; new: {', '.join(new) or 'none'}")


def numbers(words: str) -> dict[str, object]:
    """Accuracies of a command's tests, and a hash of its design; or its refusal."""
    options = words.split()
    light = [place for place, word in enumerate(options) if word in ("--photons", "--counts")]
    for place in light[:-1]:  # a case's own light stands for the usual one
        del options[place : place + 2]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "design.safetensors"
        command = [sys.executable, "-m", "deepfsi", "design", "-o", str(file), "--json"]
        made = subprocess.run([*command, *options], capture_output=True, text=True)
        if made.returncode:
            return {"refused": made.stderr.strip().splitlines()[-1]}
        tests = json.loads(made.stdout)["tests"]
        tensors = load_file(file)
    trained = sorted(name for name in tensors if not name.startswith(FOUND_AFTER))
    content = hashlib.sha256(b"".join(tensors[name].tobytes() for name in trained))
    return {
        "accuracy": [test["accuracy"] for test in tests],
        "counts": [test["counts"] for test in tests],
        "tensors": content.hexdigest()[:16],
    }


if __name__ == "__main__":
    main()
