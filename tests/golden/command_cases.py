"""Command lines of every command: exit codes, JSON, files, and what `--help` lists."""

import json
import re
from pathlib import Path
from typing import Any

from golden.facts import (
    INPUTS,
    Cases,
    answer,
    file_of,
    files,
    patterns_of,
    recording,
    say,
    timeless,
)

CASES = Cases()

EXPORTED = {
    **{
        device: ("single", f"--dmd {device}")
        for device in (
            "dlp7000", "dlp9500", "dlp650lnir", "dlp6500", "dlp6500-dlpc910", "dlp9000",
            "dlp9000x", "dlp670s", "dlp500yx", "dlp4500", "dlp3010", "dlp4710",
        )
    },
    "a device file": ("single", "--dmd loading.toml"),
    "raw, inverted": ("single", "--dmd 64x48 --format raw --invert"),
    "bmp, flipped": ("single", "--dmd 64x48 --format bmp --flip"),
    "bmp, turned": ("single", "--dmd 64x48 --format bmp --rotate 90"),
    "planes": ("dual", "--dmd dlp4500"),
    "region": ("dual", "--dmd 64x48 --region 32x32+4+8"),
    "stretch": ("dual", "--dmd 64x48 --stretch"),
    "arms": ("arms", "--dmd 64x48"),
    "detectors": ("quad", "--dmd 64x48"),
    "image": ("image", "--dmd 64x48"),
    "clicks": ("click", "--dmd 64x48"),
    "adaptive": ("adaptive", "--dmd dlp7000"),
    "passing": ("passing", "--dmd 64x48"),
    "grey levels": ("dual", "--dmd 16x16"),
    "too small": ("dual", "--dmd 4x4"),
    "too short": ("dual", "--dmd dlp4710 --exposure 1us"),
}  # fmt: skip
"""Patterns: design, and options of `dmd export`."""


@CASES.of(EXPORTED)
def exported(name: str) -> dict[str, Any]:
    """Every file of a folder of patterns, and what checks it."""
    design, words = EXPORTED[name]
    options = [INPUTS / word if word.endswith(".toml") else word for word in words.split()]
    if "--exposure" not in options:
        options += ["--exposure", "15ms" if "dlp4710" in words else "30ms"]
    out = {"said": answer("dmd", "export", file_of(design), *options, "-o", "p")}
    if Path("p").exists():
        manifest = json.loads(Path("p/manifest.json").read_text())
        del manifest["deepfsi"]  # the version
        frames = [frame.pop("sha256") for frame in manifest["frames"]]
        hashes = {key: manifest.pop(key) for key in list(manifest) if key.endswith("sha256")}
        out |= {
            "manifest": manifest,
            "hashes": {"frames": " ".join(frames).encode(), "others": str(hashes).encode()},
            "files": files("p", "manifest.json"),
            "checked": answer("dmd", "check", "p"),
        }
    return out


@CASES
def checked() -> dict[str, Any]:
    """Folders of patterns that were changed."""
    folder = Path(patterns_of("dual"))
    good = (folder / "frames.npy").read_bytes()
    out = {}
    (folder / "frames.npy").write_bytes(good[:-900] + bytes([good[-900] ^ 1]) + good[-899:])
    out["a mirror"] = answer("dmd", "check", folder)
    (folder / "frames.npy").write_bytes(good[:-9])
    out["cut"] = answer("dmd", "check", folder)
    (folder / "frames.npy").unlink()
    out["missing"] = answer("dmd", "check", folder)
    (folder / "manifest.json").write_text("{}")
    out["no manifest"] = answer("dmd", "check", folder)
    return out


@CASES
def masks() -> dict[str, Any]:
    """Photomasks of the pattern that scenes pass."""
    passing = file_of("passing")
    return {
        "svg": answer("mask", passing, "--pixel", 5, "-o", "m.svg"),
        "other": say("mask", file_of("dual"), "--pixel", 5, "-o", "n.svg").code,
        "end": answer("mask", passing, "--pixel", 5, "-o", "n.gif"),
        "files": files("."),
    }


@CASES
def graphs() -> dict[str, Any]:
    """ONNX graphs: their tensors; their weights bit for bit."""
    import onnx

    out = {}
    for design in ("single", "dual", "arms", "quad", "click", "passing", "adaptive"):
        path = f"{design}.onnx"
        said = answer("export", file_of(design), "-o", path)
        said.pop("looks", None)  # of the reference
        out[design] = {"said": said}
        if Path(path).exists():
            graph = onnx.load(path).graph
            out[design] |= {
                "inputs": [_tensor(one) for one in graph.input],
                "outputs": [_tensor(one) for one in graph.output],
                "weights": [[list(one.dims), one.raw_data] for one in graph.initializer],
            }
    return out


def _tensor(value: Any) -> list[Any]:
    kind = value.type.tensor_type
    return [value.name, kind.elem_type, [one.dim_param or one.dim_value for one in kind.shape.dim]]


@CASES.of(("single", "adaptive"))
def page(design: str) -> dict[str, Any]:
    """The data in a page to play with, and what it says in JSON."""
    out = {"said": answer("page", file_of(design), "-o", "p.html")}
    text = Path("p.html").read_text()
    blocks = re.findall(r"<script[^>]*type=.application/json.[^>]*>(.*?)</script>", text, re.DOTALL)
    for block in map(json.loads, blocks):
        for key in ("largest_score", "chooser"):  # of the reference
            block.get("exposure", {}).pop(key, None)
        for key in ("wavelengths", "clearest"):  # of the reference
            block["scenes"].pop(key, None)
        out.setdefault("data", []).append(json.dumps(block).encode())
    return out


@CASES
def described() -> dict[str, Any]:
    """Cameras: presets, files, designs and patterns."""
    Path("lab.toml").write_text('light = "equal-dwell"\nflux = 1e6\nexposure = "10ms"\n')
    Path("wrong.toml").write_text('lite = "equal-dwell"\n')
    sources = ("", "dmd", "dmd-2x2", "dmd-4x4", "two-arm", "paper", "lab.toml", "wrong.toml")
    out = {source: answer("camera", "describe", *source.split()) for source in sources}
    for design in ("quad", "adaptive", "click", "passing"):
        out[f"design {design}"] = answer("camera", "describe", file_of(design))
    out["patterns"] = answer("camera", "describe", patterns_of("quad"))
    out["run"] = answer("camera", "describe", recording("two-arms", "arms"))
    out["nosuch"] = answer("camera", "describe", "nosuch")
    return out


@CASES
def devices_and_data() -> dict[str, Any]:
    """Scenes as pictures."""
    return {
        "export": answer("data", "export", "digits", "--per-class", 2, "--seed", 1, "-o", "d"),
        "small": answer("data", "export", "digits", "--size", 4, "-o", "s"),
        "files": files("."),
        "version": say("--version").code,
        "module": say("nosuch").refused(),
        "option": say("design", "--nosuch").refused(),
    }


LEARNED = (
    "--masks 4 --epochs 1 --hidden 8 --photons 1e3",
    "--masks 4 --epochs 1 --hidden 8 --photons 1e2:1e4 --camera two-arm",
)


@CASES.of(LEARNED)
def design(words: str) -> dict[str, Any]:
    """A design that is learned: what is said, its tensors, and no other in its place."""
    from safetensors.numpy import load_file

    said = timeless(answer("design", *words.split(), "-o", "one.safetensors"))
    again = answer("design", *words.split(), "--seed", 1, "-o", "one.safetensors")
    return {"said": said, "tensors": load_file("one.safetensors"), "again": again}


TESTED = {
    "evaluate": "evaluate dual --photons 1e3,1e4 --draws 1",
    "evaluate, noise": "evaluate quad --photons 1e4 --noise gaussian --draws 1",
    "evaluate, clicks": "evaluate click --photons 1e2 --draws 1",
    "evaluate, passing": "evaluate passing --photons 1e4 --draws 1 --seed 2",
    "evaluate, adaptive": "evaluate adaptive --photons 1e4 --draws 1",
    "predict": "predict dual few --photons 1e4",
    "predict, noise": "predict quad few --photons 1e3 --noise gaussian --seed 2",
    "predict, budget": "predict dual few --photons 0",
}
"""Tests of stored designs: words, the second one a design."""


@CASES
def tested() -> dict[str, Any]:
    out = {}
    for name, words in TESTED.items():
        command, design, *others = words.split()
        pictures = [INPUTS / word if word == "few" else word for word in others]
        said = answer(command, file_of(design), *pictures)
        out[name] = timeless(said)
    out["shown"] = answer("show", file_of("dual"), "-o", "masks.png")
    out["shown, too"] = answer("show", file_of("dual"), "-o", "masks.txt")
    return out
