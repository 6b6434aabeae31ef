"""A camera's computer from nothing: installs the package without torch, records, counts, checks.

The GitHub workflow runs it on Windows; it runs anywhere, in a virtual environment of its own.
"""

import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = """
dmd export raster --size 8x8 --dmd dlp7000 -o scan
dmd check scan
data export digits --per-class 1 -o images
camera simulate scan --scene images --flux 1e7 --exposure 10ms --virtual ideal -o run
camera inspect run/photons.ptu
camera count run
"""


def main() -> None:
    """Install, run every command, and see that torch is not there."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as made:
        venv.create(Path(made) / "lab", with_pip=True)
        scripts = Path(made) / "lab" / ("Scripts" if sys.platform == "win32" else "bin")
        python = scripts / "python"
        pins = ["-c", str(ROOT / "constraints.txt")]
        subprocess.run([python, "-m", "pip", "install", "-q", *pins, f"{ROOT}[camera]"], check=True)
        for line in COMMANDS.split("\n")[1:-1]:
            print(f"deepfsi {line}", flush=True)
            words = [python, "-m", "deepfsi", *line.split()]
            subprocess.run(words, cwd=made, check=True)
        there = "import importlib.util; raise SystemExit(bool(importlib.util.find_spec('torch')))"
        subprocess.run([python, "-c", there], check=True)


if __name__ == "__main__":
    main()
