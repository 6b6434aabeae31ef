"""Every reader of what users give: a valid sample, how it is mutated, and what reads it."""

import json
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import polars
from scipy.io import savemat

from deepfsi import Camera, Design, from_arrays, load_dataset, load_design
from deepfsi.base.tables import read_table
from deepfsi.camera.device import find_device
from deepfsi.cli.studies import read_recipe
from deepfsi.counting import reader as photons
from deepfsi.counting import tables
from deepfsi.counting.acquisition import Calibration
from deepfsi.counting.recording import Recording
from deepfsi.datasets.display import read_scene_list
from deepfsi.designfile.provenance import trained_on
from deepfsi.jobs.designs import read_matrix
from deepfsi.lab import results as record
from deepfsi.lab.design_data import camera_of, design_rails
from deepfsi.lab.virtual_optics import VirtualCamera
from deepfsi.patterns.folder import Patterns
from deepfsi.report.comparison_page import write_report
from deepfsi.sweeps.plan import check_settings
from deepfsi.sweeps.recipe import only
from deepfsi.sweeps.results import read_results
from fuzz.mutations import (
    Mutation,
    changed_json,
    changed_lines,
    changed_table,
    changed_tensors,
    changed_toml,
    changed_zip,
    mangled,
)
from golden.facts import INPUTS
from shared.design_files import looks_at
from shared.pictures import save_images
from shared.results import a_point, some_results


@dataclass(frozen=True)
class Reader:
    """One kind of file."""

    sample: str  # path in the folder of samples; what it lies in is copied with it
    read: Callable[[Path], Any]
    mutations: tuple[Mutation, ...]
    weight: float = 4  # of all inputs, relative; less where figures are drawn


def use_design(path: Path) -> None:
    design = Design.load(path)
    camera_of(path)
    repr(design)
    _ = design.camera, trained_on(design.info)
    if not design.exposure.part_axis:  # whose counts are of each patch
        counts = np.ones(design.counts_shape)
        chances = design.classify(counts, 1e4)
        assert chances.shape == (len(design.classes),)
        if design.usual_misfit is not None:
            design.consistency(counts[None], 1e4)


def use_adaptive(path: Path) -> None:
    design = load_design(path)
    repr(design)
    _ = design.camera, trained_on(design.info)
    gray = np.full(design.image_shape, 0.5, np.float32).ravel()
    *_, chances = looks_at(design, gray, 1e3)
    assert np.isfinite(chances).all()


def use_patterns(path: Path) -> None:
    exported = Patterns.read(path.parent)
    assert np.isfinite(exported.rails).all()
    tables.column_names(exported.manifest)


def check_patterns(path: Path) -> None:
    top = next(each for each in path.parents if (each / "manifest.json").is_file())
    Patterns.read(top).check()


def use_run(path: Path) -> None:
    Recording.read(path.parent)
    Recording.read(path.parent).read_counts().signal()


def use_live(path: Path) -> None:
    record.read_log(path.parent)


def use_photons(path: Path) -> None:
    photons.summarise(path)
    times, _ = photons.read_markers(path)
    if len(times) > 1:
        photons.count_windows(path, times[:-1], times[1:])


def use_recipe(path: Path) -> None:
    x = np.random.default_rng(0).random((40, 4, 4))
    data = from_arrays(x, np.arange(40) % 2)
    check_settings(only(read_recipe(str(path))), lambda recipe: data)


def build_report(folder: Path) -> None:
    try:
        write_report(folder)
    finally:
        plt.close("all")


def use_camera(path: Path) -> None:
    repr(Camera.load(path.with_name("camera.toml")))


def load_small(path: Path) -> None:
    load_dataset(path.parents[1] if path.suffix == ".png" else path, size=4)


def load_masks(path: Path) -> None:
    read_matrix(str(path))


def load_table(path: Path) -> None:
    read_table(path, ("scene", "label"))


TENSORS, ZIP = (changed_tensors, mangled), (changed_zip, mangled)
JSON, TOML, TABLE = ((change, mangled) for change in (changed_json, changed_toml, changed_table))

READERS = {
    "design": Reader("fixed.safetensors", use_design, TENSORS, 10),
    "design of a range": Reader("range.safetensors", use_design, (changed_tensors,)),
    "adaptive design": Reader("adaptive.safetensors", use_adaptive, (changed_tensors,)),
    "patches": Reader("patches.safetensors", use_design, (changed_tensors,)),
    "manifest": Reader("npy/manifest.json", use_patterns, JSON, 8),
    "manifest of looks": Reader("live-adaptive/patterns/manifest.json", use_patterns,
                                (changed_json,)),
    "mirrors": Reader("npy/mirrors.npy", use_patterns, (mangled,), 2),
    "frames": Reader("npy/frames.npy", check_patterns, (mangled,), 1),
    "planes": Reader("planes/images/0000.bmp", check_patterns, (mangled,), 1),
    "bmp frames": Reader("bmp/frames/0002.bmp", check_patterns, (mangled,), 1),
    "table of planes": Reader("planes/patterns.csv", check_patterns, (mangled,), 1),
    "acquisition": Reader("both-rails/acquisition.json", use_run, JSON),
    "counted acquisition": Reader("both-rails/acquisition.json",
                                  lambda path: Recording.read(path.parent).count(), JSON, 2),
    "counts": Reader("both-rails/counts.npz", use_run, ZIP),
    "photons": Reader("clicks/photons.ptu", use_photons, (mangled,), 8),
    "shown frames": Reader("live-adaptive/shown.jsonl", use_live, (changed_lines, mangled)),
    "calibration": Reader("calibration/calibration.json",
                          lambda path: Calibration.load(path.parent).doubts, JSON),
    "scenes": Reader("scenes.csv", read_scene_list, TABLE, 3),
    "camera": Reader("camera.toml", use_camera, TOML),
    "device": Reader("device/device.toml", use_camera, (changed_toml,), 2),
    "detectors": Reader("device/map.npy", use_camera, (mangled,), 1),
    "virtual camera": Reader("virtual.toml",
                             lambda path: VirtualCamera.load(str(path)), TOML),
    "recipe": Reader("recipe.toml", use_recipe, TOML),
    "results": Reader("out/results.json", read_results, JSON),
    "report": Reader("out/results.json", lambda path: build_report(path.parent),
                     (changed_json,), 0.4),
    "report's design": Reader("out/designs/key.safetensors",
                              lambda path: build_report(path.parents[1]), (changed_tensors,), 0.4),
    "npz": Reader("data.npz", load_dataset, (changed_zip, changed_zip, mangled), 8),
    "png": Reader("folder/a/0000.png", load_small, (mangled,), 3),
    "cube": Reader("cube.mat", load_dataset, (mangled,), 3),
    "npy cube": Reader("plain.npy", load_dataset, (mangled,), 1),
    "npy masks": Reader("masks.npy", load_masks, (mangled,)),
    "mat masks": Reader("masks.mat", load_masks, (mangled,), 5),
    "old mat masks": Reader("old.mat", load_masks, (mangled,), 3),
    "csv": Reader("table.csv", load_table, TABLE, 8),
    "parquet": Reader("table.parquet", load_table, (mangled,)),
}  # fmt: skip


def copied(samples: Path, reader: Reader, folder: Path) -> Path:
    """Path of the sample of a reader in a folder of its own, with what lies beside it."""
    top = reader.sample.split("/")[0]
    folder.mkdir(parents=True)
    if (samples / top).is_dir():
        shutil.copytree(samples / top, folder / top)
    else:
        shutil.copy(samples / top, folder / top)
    for beside in samples.glob(f"{Path(top).stem}_gt.*"):
        shutil.copy(beside, folder / beside.name)
    return folder / reader.sample


# ---------------------------------------------------------------- samples

STORED = {
    "fixed.safetensors": INPUTS / "files" / "characterised.safetensors",
    "out/designs/key.safetensors": INPUTS / "files" / "fixed.safetensors",
    **{f"{name}.safetensors": INPUTS / "files" / f"{name}.safetensors"
       for name in ("range", "adaptive", "patches")},
    **{name: INPUTS / "recordings" / name for name in ("clicks", "both-rails", "live-adaptive")},
    "virtual.toml": INPUTS / "ambient.toml",
    "device/device.toml": INPUTS / "loading.toml",
}  # fmt: skip
"""Samples that are stored elsewhere."""

CAMERA = """
light = "free-dwell"
exposure = "10ms"
flux = 1e6
dark = 200
dead_time = "20ns"
rails = "single"
"""

WORDS = {
    "camera.toml": CAMERA + 'detectors = "2x2"\nlevels = 2\n',
    "device/camera.toml": CAMERA + 'device = "device.toml"\ndetectors = "map.npy"\n',
    "recipe.toml": """
data = 'digits'
designs = ['pca', 'deepfsi']
photons = [1e3, 1e4]
masks = [3, 4]
trials = 2
[camera]
light = ['column', 'equal-dwell']
[training]
epochs = 1
hidden = [8, 8]
""",
    "scenes.csv": 'name,label\n"a, b",x\nb,\nc,y\n',
    "calibration/calibration.json": """{
"homography": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "residual": 0.1, "error": 0.01,
"spots": 16, "shown": 16, "blur": [0.0, 0.1], "flat": [[1.0, 0.5], [0.5, 1.0]],
"dead_time": {"seconds": 1e-8, "paralysable": false}}""",
}
"""Samples of a few words."""


def make_samples(folder: Path) -> None:
    """Write a small valid file of each kind."""
    rng = np.random.default_rng(0)
    for name, source in STORED.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copy)(source, folder / name)
    for name, words in WORDS.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(words)
    Recording.read(folder / "both-rails").count()
    device, rails = find_device("24x16"), design_rails(folder / "fixed.safetensors")
    packed = device.model_copy(update={"controller": "dlpc900"})
    for kind, shown in {"npy": device, "bmp": device, "planes": packed}.items():
        Patterns.from_rails(rails, shown, 1e-3, format=kind).write(folder / kind)
    points = [a_point(photons=photons, masks=4) for photons in (1e2, 1e4)]
    written = some_results(points, data={"image_shape": (4, 4)}).as_dict()
    (folder / "out" / "results.json").write_text(json.dumps(written))
    x = rng.integers(0, 255, (20, 4, 4), dtype=np.uint8)
    np.savez_compressed(folder / "data.npz", x=x, y=np.array(["a", "b"] * 10))
    _pictures(folder, x)
    _arrays(folder, rng)


def _pictures(folder: Path, x: np.ndarray) -> None:
    for place, kind in enumerate(("png", "bmp", "jpg", "gif", "tif")):
        for label in "ab":
            save_images(folder / "folder" / label, x[place::5][:2], f"{place}.{kind}")


def _arrays(folder: Path, rng: np.random.Generator) -> None:
    masks, table = rng.random((3, 4, 4)), rng.integers(0, 50, (5, 6)).astype(float)
    np.save(folder / "device" / "map.npy", np.arange(16) % 4)
    np.save(folder / "masks.npy", masks)
    savemat(folder / "masks.mat", {"masks": masks, "other": "text"}, do_compression=True)
    savemat(folder / "old.mat", {"masks": masks[0]}, format="4")
    cube, labels = rng.random((12, 12, 3)), rng.integers(0, 3, (12, 12))
    savemat(folder / "cube.mat", {"cube": cube})
    savemat(folder / "cube_gt.mat", {"labels": labels})
    np.save(folder / "plain.npy", cube)
    np.save(folder / "plain_gt.npy", labels)
    frame = polars.DataFrame(table, schema=[f"mask{k}" for k in range(6)], orient="row")
    frame = frame.with_columns(scene=polars.Series(list("abcde")))
    frame.write_csv(folder / "table.csv")
    frame.write_parquet(folder / "table.parquet")


def drawn(reader: Reader, seed: int, name: str, content: bytes) -> bytes:
    """Input of a seed."""
    rng = random.Random(f"{name} {seed}")
    return rng.choice(reader.mutations)(rng, content)
