"""Runs that are stored, recorded, counted, classified and lived; tables of counts."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from golden.facts import (
    DATA,
    INPUTS,
    Cases,
    answer,
    arrays,
    cleaned,
    file_of,
    files,
    patterns_of,
    recording,
    refused_or,
    say,
)

CASES, REAL_CASES = Cases(), Cases()
"""The latter need `DEEPFSI_DATA`."""

DESIGNS = {
    **dict.fromkeys(("one-arm", "paralysable", "drifting", "edges"), "single"),
    **dict.fromkeys(("drift", "ambient", "fluctuating"), "single"),
    **dict.fromkeys(("both-rails", "jump", "brighter"), "dual"),
    **dict.fromkeys(("gains", "blind"), "quad"),
    "two-arms": "arms",
    "image": "image",
    "clicks": "click",
}
"""Design of each stored run."""

LIVED = {f"live-{name}": name for name in ("adaptive", "adaptive-arms", "adaptive-quad")}
"""Design of each stored live run."""

COUNTED = {
    "one-arm": (
        "--dead-time 200ns",
        "--dead-time 0",
        "--dead-time 200ns --dead-time-model paralysable",
        "--exposure 2ms",
    ),
    "both-rails": ("", "--exposure 1ms"),
    "two-arms": ("", "--dead-time 100ns"),
    "paralysable": ("", "--dead-time 1us --dead-time-model paralysable", "--dead-time 2us"),
    "gains": ("", "--dead-time 1us"),
    "clicks": ("", "--exposure 5ms"),
    "edges": ("", "--dead-time 50ns"),
}
"""Options of `camera count` that stored runs are counted with, beside none."""


@CASES.of(DESIGNS)
def counted(name: str) -> dict[str, Any]:
    """A stored run, counted in several ways and classified after each."""
    run, design = recording(name, DESIGNS[name]), DESIGNS[name]
    out = {}
    for words in COUNTED.get(name, ("",)):
        said = {"count": answer("camera", "count", run, *words.split())}
        if Path(run, "counts.npz").exists():
            said["arrays"] = arrays(Path(run, "counts.npz"))
        out[words] = said
        if name == "edges":  # the reference refuses all of it for a scene that is dark
            continue
        said["classes"] = answer("camera", "classify", file_of(design), run)
        if "code" in said["classes"]:
            said["forced"] = answer("camera", "classify", Path(run, "patterns"), run, "--force")
    return out


@CASES.of(LIVED)
def replayed(name: str) -> dict[str, Any]:
    """Classes of a stored live run of virtual devices."""
    run = recording(name, LIVED[name])
    return {
        "decisions": _classified(file_of(LIVED[name]), run),
        "other design": _classified(file_of("quad"), run),
    }


def _classified(design: Path, run: str | Path) -> dict[str, Any]:
    """Classes of a live run, without what only the reference says."""
    said = answer("camera", "classify", design, run)
    said.pop("remarks", None)  # the reference has none of live runs
    for scene in said.get("scenes", ()):
        for name in ("agrees", "bit_for_bit"):
            scene.pop(name, None)
    return said


WITHOUT_TORCH = """
import contextlib, io, json, runpy, sys

class NoTorch:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "torch":
            raise ModuleNotFoundError(name, name=name)

sys.meta_path.insert(0, NoTorch())
for line in sys.stdin:
    sys.argv, code, out = ["deepfsi", *line.split(), "--json"], 0, io.StringIO()
    try:
        with contextlib.redirect_stdout(out):
            runpy.run_module("deepfsi", run_name="__main__")
    except SystemExit as stop:
        code = stop.code or 0
    print(json.dumps(json.loads(out.getvalue() or "{}") | {"code": code}))
"""


@CASES
def without_torch() -> dict[str, Any]:
    """Commands of a camera's computer that has no torch: patterns and counts."""
    run = recording("one-arm", "single")
    lines = {
        "export": f"dmd export {file_of('single')} --dmd 64x48 --exposure 10ms -o p",
        "count": f"camera count {run}",
    }
    words, asked = [sys.executable, "-c", WITHOUT_TORCH], "\n".join(lines.values())
    said = subprocess.run(words, input=asked, capture_output=True, text=True, check=True)
    answers = map(json.loads, said.stdout.splitlines())
    return {name: cleaned(one) for name, one in zip(lines, answers, strict=True)}


@CASES
def with_a_flat() -> dict[str, Any]:
    """Efficiencies of several detectors from a run of uniform white with the same patterns."""
    run, patterns = recording("gains", "quad"), patterns_of("quad")
    for flat, flux in (("flat", "1e8"), ("dim", "1e6")):
        words = ("--virtual", INPUTS / "gains.toml", "--flux", flux, "--exposure", "10ms")
        answer("camera", "simulate", patterns, "--scene", INPUTS / "white", *words, "-o", flat)
    return {
        "uncounted": answer("camera", "count", run, "--flat", "flat"),
        "flat": answer("camera", "count", "flat"),
        "count": answer("camera", "count", run, "--flat", "flat"),
        "arrays": arrays(Path(run, "counts.npz")),
        "classes": answer("camera", "classify", file_of("quad"), run),
        "dim": [
            answer("camera", "count", "dim")["exposures"],
            answer("camera", "count", run, "--flat", "dim"),
        ],
    }


@CASES
def inspected() -> dict[str, Any]:
    """Photon files that are listed, one cut."""
    run = recording("both-rails", "dual")
    answer("camera", "count", run)
    out = {
        "whole": answer("camera", "inspect", Path(run, "photons.ptu")),
        "arms": answer("camera", "inspect", INPUTS / "recordings/two-arms/photons.ptu"),
    }
    Path("cut.ptu").write_bytes(Path(run, "photons.ptu").read_bytes()[:-401])
    said = say("camera", "inspect", "cut.ptu", "--json")
    return {**out, "cut": said.code, "lines": said.errors.count("\n")}


SIMULATED = {
    "one arm": ("single", "--virtual pmt --flux 1e6"),
    "one arm, spad": ("dual", "--virtual spad --flux 1e6 --exposure 4.5ms --repeats 2"),
    "two arms": ("arms", "--virtual ideal --flux 2e5 --exposure 5ms --dark 2e3"),
    "detectors": ("quad", "--virtual gains.toml --flux 6e5 --dead-time 1us"),
    "parts of an image": ("image", "--virtual halves.toml --flux 4e5 --input 2 --input 1"),
    "paralysable": ("single", "--virtual slow.toml --flux 6e5 --seed 4"),
    "view": ("single", "--virtual mirrored.toml --flux 4e5"),
    "ambient": ("single", "--virtual ambient.toml --flux 4e5 --settle 20us"),
    "fluctuating": ("dual", "--virtual fluctuating.toml --flux 4e5"),
    "too long": ("dual", "--virtual ideal --flux 4e5 --exposure 20ms"),
}
"""Runs of a virtual camera: design, and options of `camera simulate`."""


@CASES.of(SIMULATED)
def simulated(name: str) -> dict[str, Any]:
    """A recording of the virtual camera: every file of it, and its counts."""
    return _made("simulate", *SIMULATED[name])


def _made(command: str, design: str, words: str) -> dict[str, Any]:
    options = [INPUTS / word if word.endswith(".toml") else word for word in words.split()]
    shown = ["--scene", INPUTS / "few", "--exposure", "10ms", *options, "-o", "run"]
    out = {"said": answer("camera", command, patterns_of(design), *shown)}
    if command == "live":
        out["said"].pop("remarks", None)
    if Path("run").exists():
        out["settings"] = json.loads(Path("run", "acquisition.json").read_text())
        out["files"] = files("run", "manifest.json", "acquisition.json", "counts.npz")
        if command != "live":
            out["counted"] = answer("camera", "count", "run")
    return out


RECORDED = {
    "one arm": ("single", "--virtual ideal --flux 4e5"),
    "rails": ("dual", "--virtual pmt --flux 1e6"),
    "two arms": ("arms", "--virtual spad --flux 2e5 --exposure 5ms"),
    "detectors": ("quad", "--virtual gains.toml --flux 6e5 --marker 2"),
    "fluctuating": ("single", "--virtual fluctuating.toml --flux 4e5 --dark 500"),
}
"""Runs of virtual devices: design, and options of `camera record`."""


@CASES.of(RECORDED)
def recorded(name: str) -> dict[str, Any]:
    """A recording of virtual devices: every file of it, and its counts."""
    return _made("record", *RECORDED[name])


LIVE = {
    "adaptive, dark counts": ("adaptive", "--virtual ideal --flux 1e6 --dark 2e4"),
    "adaptive, dead time": ("adaptive", "--virtual spad --flux 1e6 --dead-time 50ns --until 0.5"),
    "adaptive, arms": ("adaptive-arms", "--virtual ideal --flux 1.5e5 --until 0.7"),
    "adaptive, detectors": ("adaptive-quad", "--virtual ideal --flux 1e6 --dark 2e3"),
}
"""Live runs: design, and options of `camera live`."""


@CASES.of(LIVE)
def lived(name: str) -> dict[str, Any]:
    """A live run of virtual devices: its decisions, files and classes."""
    design, words = LIVE[name]
    out = _made("live", design, words)
    if Path("run").exists():
        out["replayed"] = _classified(file_of(design), "run")
    return out


@CASES
def transits() -> dict[str, Any]:
    """Scenes that passed a pattern, in a photon file without markers."""
    ptu, design = INPUTS / "passing.ptu", file_of("passing")
    out = {}
    for words in ("", "--photons 3e3", "--background 500 --false-alarms 1", "--input 2"):
        table = ("-o", "found.csv", "--force")
        said = answer("camera", "transits", design, ptu, "--bin", "1ms", *words.split(), *table)
        out[words] = {"said": said}
        if Path("found.csv").exists():
            out[words]["table"] = Path("found.csv").read_bytes()
    out["bin"] = answer("camera", "transits", design, ptu, "--bin", "0")
    out["other"] = say("camera", "transits", file_of("single"), ptu, "--bin", "1ms").code
    return out


TABLES = {
    "single": ("", "--settle 10us", "--background 3", "--photons 4e3"),
    "dual": ("", "--dead-time 1us"),
    "arms": ("", "--settle 10us"),
    "quad": ("", "--background 1"),
    "click": ("--photons 500",),
}
"""Options of `camera classify` that each stored table of counts is classified with."""


@CASES.of(TABLES)
def table(name: str) -> dict[str, Any]:
    """A table of counts, behind the folder of patterns and behind the design alone."""
    source, patterns = INPUTS / "tables" / f"{name}.csv", patterns_of(name)
    return {
        f"{shown}, {words}": answer("camera", "classify", asked, source, *words.split())
        for words in TABLES[name]
        for shown, asked in (("patterns", patterns), ("design", file_of(name)))
    }


@CASES
def tables_of_each_format() -> dict[str, Any]:
    """One table in every format that is read, and with names."""
    import polars
    from scipy.io import savemat

    values = np.loadtxt(INPUTS / "tables/single.csv", delimiter=",")
    names = ["scene", "label", "on", "off", *(f"mask{k}" for k in range(6)), "on2", "off2"]
    values = values[:, : len(names) - 2]
    rows = [f"s{k},{k},{','.join(f'{v:.0f}' for v in row)}" for k, row in enumerate(values)]
    Path("names.csv").write_text("\n".join([",".join(names), *rows]))
    np.savetxt("comment.csv", values, delimiter=",", fmt="%d", header="a comment")
    np.save("array.npy", values.astype(np.int32))
    savemat("one.mat", {"counts": values, "other": np.eye(3)})
    savemat("two.mat", {"a": values, "b": values})
    polars.DataFrame({f"c{k}": column for k, column in enumerate(values.T)}).write_parquet(
        "p.parquet"
    )
    polars.read_csv("names.csv").write_parquet("names.parquet")
    asked = patterns_of("single")
    files_and_words = (
        "names.csv", "comment.csv", "array.npy", "one.mat", "two.mat:b", "p.parquet",
        "names.parquet",
        # refused:
        "two.mat", "nosuch.csv",
    )  # fmt: skip
    return {words: answer("camera", "classify", asked, *words.split()) for words in files_and_words}


@CASES
def calibrated() -> dict[str, Any]:
    """Spots through a tilted camera, recorded and counted."""
    Path("tilted.toml").write_text(
        "view = [[0.9, 0.04, 0.03], [-0.03, 0.92, 0.05], [0.01, 0.02, 1.0]]\ndark = 1e3\n"
    )
    device = ("--dmd", "64x64", "--dwell", "2ms")
    out = {"export": answer("dmd", "export", "hadamard", "--size", "8x8", *device, "-o", "p")}
    say("camera", "spots", "--size", "32x32", "-o", "p/spots")  # as the reference makes them
    out["pictures"] = files("p/spots")
    words = ("--scene", "p/spots", "--flux", "1e6", "--exposure", "0.2s", "--repeats", 1)
    camera = ("--virtual", "tilted.toml", "-o", "run")
    out["run"] = answer("camera", "simulate", "p", *words, *camera)
    out["count"] = answer("camera", "count", "run")
    return out


@CASES
def public_names() -> dict[str, Any]:
    """`classify_run`, `classify_table` and `predict`, as a program of the user calls them."""
    import deepfsi

    dual, counts = file_of("dual"), INPUTS / "tables/dual.csv"
    run = recording("jump", "dual")
    answer("camera", "count", run)
    loaded = deepfsi.load_design(dual)
    np.savetxt("negative.csv", -np.loadtxt(counts, delimiter=","), delimiter=",")
    out = {
        "run": cleaned(deepfsi.classify_run(dual, run).as_dict()),
        "table": cleaned(deepfsi.classify_table(dual, counts).as_dict()),
        "predict": cleaned(deepfsi.predict(loaded, INPUTS / "few", 1e4, seed=1).as_dict()),
        "camera": loaded.camera.model_dump(mode="json"),
    }
    wrong = {
        "table": lambda: deepfsi.classify_table(dual, "negative.csv"),
        "run": lambda: deepfsi.classify_run(file_of("single"), run),
        "budget": lambda: deepfsi.predict(loaded, INPUTS / "few", 0.0),
    }
    return {**out, "wrong": {name: refused_or(call) for name, call in wrong.items()}}


@REAL_CASES
def real_photons() -> dict[str, Any]:
    """Files of PicoQuant devices: listed, or refused."""
    out = {}
    for name in ("hydraharp_v20_t2", "hydraharp_v20_t3", "picoharp_v30_t2"):
        out[name] = answer("camera", "inspect", DATA / "ptu" / f"{name}.ptu")
    out["spc"] = answer("camera", "inspect", DATA / "bh/test_noise.spc")
    return out
