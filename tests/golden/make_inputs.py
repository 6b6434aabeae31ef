"""Makes the stored inputs of the golden cases of runs; run once, with the package of `REFERENCE`.

    PYTHONPATH=<checkout of the reference>/src python tests/golden/make_inputs.py FOLDER

Tests read what it wrote and never run it: a change of training or of the virtual camera must not
change what is counted. It uses the command line and numpy only. Photons and markers of damaged runs
are changed here, record by record, in the files that the virtual camera wrote.
"""

import contextlib
import io
import json
import shutil
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

WRAP = 1 << 25
"""Ticks of an overflow of a T2 record."""

DESIGNS = {
    "dual": "--rails dual --light equal-dwell --readout both --masks 6",
    "single": "--rails single --light free-dwell --masks 6",
    "arms": "--camera two-arm --masks 6",
    "quad": "--rails single --light free-dwell --detectors 2x2 --masks 4",
    "image": "--rails single --light equal-dwell --detectors halves.npy --masks 4",
    "click": "--rails single --light equal-dwell --noise click --gates 4 --masks 12 --photons 100",
    "looks": "--rails single --light free-dwell --levels 2 --looks 3 --masks 6 --hold-out 200",
    "looks-dual": "--rails dual --light free-dwell --readout both --looks 3 --masks 6",
    "looks-arms": "--camera two-arm --looks 3 --masks 6 --photons 1.5e3",
    "looks-quad": "--rails single --light free-dwell --detectors 2x2 --looks 3 --masks 4",
    "adaptive": "--design adaptive --masks 3 --clusters 2",
    "adaptive-arms": "--design adaptive --camera two-arm --masks 3 --clusters 2 --photons 1.5e3",
    "adaptive-quad": "--design adaptive --detectors 2x2 --masks 3 --clusters 2",
    "passing": "--bins 10 --speed 2 --pattern-width 12 --levels 2",
}
"""Options of each design, on digits of 8 x 8 pixels."""


def say(*words: object) -> str:
    """Run a command line in this process; gives what it printed."""
    from deepfsi import cli

    sys.argv = ["deepfsi", *map(str, words)]
    out = io.StringIO()
    try:
        with contextlib.redirect_stdout(out):
            cli.run_command_line()
    except SystemExit as stop:
        if stop.code:
            raise
    return out.getvalue()


def read_events(path: Path) -> tuple[bytes, np.ndarray, np.ndarray]:
    """Header, times in ticks, and codes of a T2 file: an input, or minus the bits of a marker."""
    raw = path.read_bytes()
    end = raw.index(b"Header_End") + 48
    words = np.frombuffer(raw[end:], "<u4").astype(np.int64)
    special, channel, time = words >> 31, words >> 25 & 63, words & WRAP - 1
    wraps = (special == 1) & (channel == 63)
    times = time + WRAP * np.cumsum(np.where(wraps, np.maximum(time, 1), 0))
    return raw[:end], times[~wraps], np.where(special == 1, -channel, channel)[~wraps]


def write_events(path: Path, header: bytes, times: np.ndarray, codes: np.ndarray) -> None:
    """Write a T2 file with this header, its number of records as it now is."""
    order = np.argsort(times, kind="stable")
    times, codes = times[order], codes[order]
    special = np.where(codes < 0, 1 << 31 | -codes << 25, codes << 25)
    words, wraps = special | times % WRAP, times // WRAP
    steps = np.diff(wraps, prepend=0)
    places = np.flatnonzero(steps)
    words = np.insert(words, places, 1 << 31 | 63 << 25 | steps[places])
    place = header.index(b"TTResult_NumberOfRecords") + 40
    header = header[:place] + struct.pack("<q", len(words)) + header[place + 8 :]
    path.write_bytes(header + words.astype("<u4").tobytes())


Course = Callable[[np.ndarray], np.ndarray]
"""Light, at most 1, at times in passes: 2.5 is the middle of the third pass."""


def dim(run: Path, course: Course) -> None:
    """Leave a share of the photons."""
    header, times, codes = read_events(run / "photons.ptu")
    scenes = len(json.loads((run / "acquisition.json").read_text())["scenes"])
    markers = times[codes < 0]
    starts = markers[:: len(markers) // scenes]
    starts = np.append(starts, 2 * starts[-1] - starts[-2])
    keep = np.random.default_rng(7).random(len(times)) < course(
        np.interp(times, starts, np.arange(scenes + 1))
    )
    keep |= codes < 0
    write_events(run / "photons.ptu", header, times[keep], codes[keep])


def lose_markers(run: Path, places: list[int]) -> None:
    header, times, codes = read_events(run / "photons.ptu")
    keep = np.ones(len(times), bool)
    keep[np.flatnonzero(codes < 0)[places]] = False
    write_events(run / "photons.ptu", header, times[keep], codes[keep])


def shift_markers(run: Path, shifts: dict[int, int]) -> None:
    """Move markers, by ticks."""
    header, times, codes = read_events(run / "photons.ptu")
    markers = np.flatnonzero(codes < 0)
    for place, ticks in shifts.items():
        times[markers[place]] += ticks
    write_events(run / "photons.ptu", header, times, codes)


def add_markers(run: Path, after: dict[int, int]) -> None:
    """Add a marker so many ticks after a marker."""
    header, times, codes = read_events(run / "photons.ptu")
    markers = np.flatnonzero(codes < 0)
    extra = [times[markers[place]] + ticks for place, ticks in after.items()]
    bits = np.full(len(extra), codes[markers[0]])
    write_events(run / "photons.ptu", header, np.append(times, extra), np.append(codes, bits))


def add_at_edges(run: Path) -> None:
    """Add photons around the first and the last tick of each gate of a mask."""
    header, times, codes = read_events(run / "photons.ptu")
    exposure_s = json.loads((run / "acquisition.json").read_text())["exposure_s"]
    frames = json.loads((run / "patterns/manifest.json").read_text())["frames"]
    extra = []
    for place, start in enumerate(times[codes < 0]):
        share = frames[place % len(frames)]["share"]
        first, last = start + 10_000_000, start + 10_000_000 + round(share * exposure_s * 1e12)
        extra += [first - 1, first, first + 1, last - 1, last, last + 1] if share else []
    photons = np.zeros(len(extra), np.int64)
    write_events(run / "photons.ptu", header, np.append(times, extra), np.append(codes, photons))


def stretch(run: Path, rate: float) -> None:
    """Let the devices' clock run slow by this share."""
    header, times, codes = read_events(run / "photons.ptu")
    write_events(run / "photons.ptu", header, np.rint(times * (1 + rate)).astype(np.int64), codes)


RUNS = {
    # name: patterns, options of `camera simulate`, change of its photons.
    "one-arm": ("single", "--virtual pmt --dead-time 200ns --flux 1e6", None),
    "both-rails": ("dual", "--virtual ideal --flux 5e5 --exposure 4.5ms --repeats 2", None),
    "two-arms": ("arms", "--virtual spad --dead-time 28.5ns --flux 3e5 --exposure 5ms", None),
    "paralysable": (
        "single",
        "--virtual slow.toml --dead-time 2us --dead-time-model paralysable --flux 3e5",
        None,
    ),
    "gains": ("quad", "--virtual gains.toml --flux 6e5", None),
    "image": ("image", "--virtual halves.toml --flux 4e5", None),
    "clicks": ("click", "--flux 5e4", None),
    "lost": ("dual", "--virtual ideal --flux 3e5", lambda run: lose_markers(run, [5, 40, 41])),
    "late": (
        "dual",
        "--virtual ideal --flux 3e5",
        lambda run: shift_markers(run, {20: 60_000_000, 50: 400_000_000}),
    ),
    "extra": (
        "dual",
        "--virtual ideal --flux 3e5",
        lambda run: add_markers(run, {7: 300_000_000, 33: 1_000_000}),
    ),
    "drifting": ("single", "--virtual ideal --flux 3e5", lambda run: stretch(run, 3e-4)),
    "edges": ("single", "--virtual ideal --flux 3e5", add_at_edges),
    "flicker": (
        "single",
        "--virtual ideal --flux 7e5",
        lambda run: dim(run, lambda t: 0.7 + 0.3 * np.sin(2 * np.pi * 2.67 * t)),
    ),
    "drift": (
        "single",
        "--virtual ideal --flux 5e5",
        lambda run: dim(run, lambda t: 1 - 0.6 * np.clip(t - 1, 0, 2) / 2),
    ),
    "jump": (
        "dual",
        "--virtual ideal --flux 5e5",
        lambda run: dim(run, lambda t: np.where(t > 3, 0.35, 1.0)),
    ),
    "brighter": (
        "dual",
        "--virtual ideal --flux 5e5",
        lambda run: dim(
            run,
            lambda t: np.where((np.floor(t) == 1) & (abs(t % 1 - 0.5) > 0.3), 0.1, 1.0),
        ),
    ),
    "blind": ("quad", "--virtual blind.toml --flux 4e5", None),
    "ambient": ("single", "--virtual ambient.toml --flux 4e5", None),
    "fluctuating": ("single", "--virtual fluctuating.toml --flux 4e5", None),
}
"""Recorded runs; each has the scenes of the folder `scenes`, the last one dark."""

CAMERAS = {
    "gains": "efficiency = 0.5\ngains = [1.0, 0.8, 0.9, 0.6]\ndark = 300\n",
    "blind": "gains = [1.0, 0.8, 0.0001, 0.6]\n",
    "slow": "dead_time_s = 2e-6\nparalysable = true\nafterpulse_probability = 0.02\n",
    "mirrored": "view = [[-1, 0, 1], [0, 1, 0], [0, 0, 1]]\nfluctuation = 0.02\n",
    "halves": "gains = [0.9, 0.5]\ndark = 200\n",
    "ambient": "ambient = 1e5\nvignetting = 0.2\nblur = 1.5\ndark = 500\n",
    "fluctuating": "fluctuation = 0.1\nfluctuation_s = 2e-3\n",
}

LIVE = {
    # name: patterns or design, options of `camera live`
    "live": ("looks", "--flux 8e5"),
    "live-rails": ("looks-dual", "--flux 1e6 --background --virtual spad --dead-time 100ns"),
    "live-arms": ("looks-arms", "--flux 1.5e5 --shortest-dwell 400us"),
    "live-quad": ("looks-quad", "--flux 1e6 --until 0.6"),
    "live-adaptive": ("adaptive", "--flux 1e6 --dark 2e4 --dead-time 50ns"),
    "live-adaptive-arms": ("adaptive-arms", "--flux 1.5e5 --until 0.7"),
    "live-mirrored": ("looks", "--flux 6e5 --virtual mirrored.toml"),
    "live-fluctuating": ("looks-dual", "--flux 4e5 --virtual fluctuating.toml"),
    "live-adaptive-quad": ("adaptive-quad", "--flux 1e6 --dark 2e3"),
}
"""Live runs of the scenes in `few`."""


def main() -> None:
    root = Path(sys.argv[1]).resolve()
    root.mkdir(parents=True, exist_ok=True)
    with contextlib.chdir(root):
        make_designs()
        make_runs()
        make_live_runs()
        make_passing_scenes()
        make_tables()


def make_designs() -> None:
    Path("designs").mkdir()
    np.save("halves.npy", np.repeat([[0, 1]], 8, axis=0).repeat(4, axis=1))
    for name, words in DESIGNS.items():
        out = f"designs/{name}.safetensors"
        light = [] if "--photons" in words else ["--photons", "1e4"]
        steps = [] if "adaptive" in words else ["--epochs", "4", "--hidden", "8"]
        print(name, say("design", *words.split(), *light, *steps, "-o", out)[-200:])


def make_runs() -> None:
    say("data", "export", "digits", "--per-class", 1, "-o", "all-scenes")
    for folder, labels in (("scenes", "01234"), ("few", "259"), ("two", "29")):
        for label in labels:
            shutil.copytree(f"all-scenes/{label}", f"{folder}/{label}")
    shutil.rmtree("all-scenes")
    from PIL import Image

    Path("scenes/dark").mkdir()
    Image.new("L", (8, 8)).save("scenes/dark/dark.png")
    Path("white").mkdir()
    Image.new("L", (8, 8), 255).save("white/white.png")
    for name, text in CAMERAS.items():
        Path(f"{name}.toml").write_text(text)
    for name, (design, words, change) in RUNS.items():
        patterns = export(design)
        run = Path("recordings", name)
        scenes = ["--scene", "scenes", "--exposure", "10ms", "--seed", "3"]
        print(name, say("camera", "simulate", patterns, *scenes, *words.split(), "-o", run)[-200:])
        if change:
            change(run)
        (run / "patterns" / "design.safetensors").unlink()
    shutil.rmtree("patterns")


def make_live_runs() -> None:
    Path("loading.toml").write_text(DEVICE)
    for name, (design, words) in LIVE.items():
        patterns = export(design)
        run = Path("recordings", name)
        pictures = "two" if "arms" in name or "quad" in name else "few"
        scenes = ["--scene", pictures, "--exposure", "10ms", "--seed", "3"]
        if "--virtual" not in words:
            scenes += ["--virtual", "ideal"]
        print(name, say("camera", "live", patterns, *scenes, *words.split(), "-o", run)[-200:])
        (run / "patterns" / "design.safetensors").unlink()
    shutil.rmtree("patterns")


def make_passing_scenes() -> None:
    """Photons of scenes that pass the pattern, one every 30 ms, with their background."""
    from PIL import Image

    from deepfsi import load_design

    design = load_design("designs/passing.safetensors")
    rng, bin_ticks = np.random.default_rng(5), 10**9
    times = [rng.integers(0, 300 * bin_ticks, 150)]
    for number, path in enumerate(sorted(Path("scenes").rglob("*.png"))):
        scene = np.asarray(Image.open(path), float).ravel() / 255
        expected = 3e3 * design.matrix @ scene / design.summed_reflectance
        for place, count in enumerate(rng.poisson(expected)):
            start = (20 + 40 * number + place) * bin_ticks
            times.append(rng.integers(start, start + bin_ticks, count))
    header, _, _ = read_events(Path("recordings/one-arm/photons.ptu"))
    joined = np.concatenate(times)
    write_events(Path("passing.ptu"), header, joined, np.zeros(len(joined), np.int64))


def make_tables() -> None:
    """Photons from each marker to the next, a row for each scene; and events as columns."""
    Path("tables").mkdir()
    for table, run in (
        ("single", "drifting"),
        ("dual", "jump"),
        ("arms", "two-arms"),
        ("quad", "gains"),
        ("click", "clicks"),
    ):
        _, times, codes = read_events(Path("recordings", run, "photons.ptu"))
        acquisition = json.loads(Path("recordings", run, "acquisition.json").read_text())
        starts, inputs = times[codes < 0], len(acquisition["inputs"])
        frame = np.searchsorted(starts, times[codes >= 0], side="right") - 1
        cells = np.bincount(frame * inputs + codes[codes >= 0], minlength=len(starts) * inputs)
        rows = cells.reshape(len(acquisition["scenes"]), -1)[:-1]  # the last one is dark
        np.savetxt(f"tables/{table}.csv", rows, delimiter=",", fmt="%d")
        if table == "single":
            np.savetxt("tables/cumulative.txt", np.cumsum(cells), fmt="%d")
            events = np.stack([times, np.where(codes < 0, 8, codes)], axis=1)[:3000]
            np.savetxt("tables/events.csv", events, delimiter=",", fmt="%d")


DEVICE = """\
name = "loading"
columns = 64
rows = 48
shortest_us = 44
settle_us = 10.0
load_us = 100
"""


def export(design: str) -> Path:
    """Patterns of a design, on a small device."""
    folder = Path("patterns", design)
    device = "loading.toml" if "adaptive" in design else "64x48"
    if not folder.exists():
        words = ["--device", device, "--exposure", "10ms", "-o", folder]
        say("dmd", "export", f"designs/{design}.safetensors", *words)
    return folder


if __name__ == "__main__":
    main()
