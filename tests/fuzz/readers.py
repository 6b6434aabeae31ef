"""Every reader of what users give: a valid sample, how it is mutated, and what reads it."""

import json
import random
import shutil
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from fuzz.mutations import (
    Mutation,
    changed_envi,
    changed_json,
    changed_lines,
    changed_table,
    changed_tensors,
    changed_toml,
    changed_zip,
    mangled,
)


@dataclass(frozen=True)
class Reader:
    """One kind of file."""

    sample: str  # path in the folder of samples; what it lies in is copied with it
    read: Callable[[Path], Any]
    mutations: tuple[Mutation, ...]
    weight: int = 4  # of all inputs, relative


def read_design(path: Path) -> None:
    from deepfsi import Design
    from deepfsi.designfile import trained_on
    from deepfsi.evaluation import stopping
    from deepfsi.lab import camera_of

    design = Design.load(path)
    camera_of(path)
    repr(design)
    _ = design.camera, trained_on(design.info)
    if design.exposure.chooses:
        stopping.rule_of(design)
    elif design.exposure.kind != "patches":  # whose counts are of each patch
        counts = np.ones(design.counts_shape)
        chances = design.classify(counts, 1e4)
        assert chances.shape == (len(design.classes),)
        if design.distribution is not None:
            design.consistency(counts[None], 1e4)


def read_adaptive(path: Path) -> None:
    from deepfsi import load_design
    from deepfsi.designfile import trained_on

    design = load_design(path)
    repr(design)
    _ = design.camera, trained_on(design.info)
    *_, chances = design.looks_at(np.full(design.image_shape, 0.5, np.float32).ravel(), 1e3)
    assert np.isfinite(chances).all()


def read_shown_design(path: Path) -> None:
    from deepfsi.lab import design_rails

    design_rails(path)


def read_loop(path: Path) -> None:
    from deepfsi.designfile import read_loop
    from deepfsi.hardware.patterns import read_patterns

    patterns = read_patterns(path.parent)
    rails, image_shape, _ = patterns.realised
    about = patterns.manifest.light, patterns.manifest.summed_reflectance
    facts = dict(zip(("light", "summed_reflectance"), about, strict=True))
    design = read_loop(path, rails, image_shape=image_shape, **facts)
    assert np.isfinite(design.first_dwell).all()


def read_patterns(path: Path) -> None:
    from deepfsi.hardware.counting import tables
    from deepfsi.hardware.patterns import read_patterns

    patterns = read_patterns(path.parent)
    assert np.isfinite(patterns.rails).all()
    tables.column_names(patterns.manifest)


def check_patterns(path: Path) -> None:
    from deepfsi.hardware.patterns import check_patterns

    top = next(each for each in path.parents if (each / "manifest.json").is_file())
    check_patterns(top)


def read_run(path: Path) -> None:
    from deepfsi.hardware.counting import read_counts, read_run

    read_run(path.parent)
    read_counts(path.parent).signal()


def read_ptu(path: Path) -> None:
    from deepfsi.hardware.photons import count_windows, read_markers, summarise

    summarise(path)
    times, _ = read_markers(path)
    if len(times) > 1:
        count_windows(path, times[:-1], times[1:])


def read_live(path: Path) -> None:
    from deepfsi.hardware.live import LiveCounts

    LiveCounts.read(path.parent)


def read_calibration(path: Path) -> None:
    from deepfsi.hardware.counting import Calibration

    _ = Calibration.load(path.parent).doubts


def read_scenes(path: Path) -> None:
    from deepfsi.lab.scenes import read_scenes

    read_scenes(path)


def read_camera(path: Path) -> None:
    from deepfsi.camera import Camera

    repr(Camera.load(path))


def read_virtual(path: Path) -> None:
    from deepfsi.hardware.virtual import VirtualCamera

    VirtualCamera.load(str(path))


def read_recipe(path: Path) -> None:
    from deepfsi import from_arrays
    from deepfsi.cli.studies import read_recipe
    from deepfsi.sweeps import check_settings, only

    x = np.random.default_rng(0).random((40, 4, 4))
    data = from_arrays(x, np.arange(40) % 2)
    check_settings(only(read_recipe(str(path))), lambda recipe: data)


def read_index(path: Path) -> None:
    from deepfsi.designfile import CollectionIndex

    CollectionIndex.read(path.parent)


def read_list(path: Path) -> None:
    from deepfsi.sweeps import Collection

    for recipe in Collection.read(path).designs.values():
        _ = recipe.job, recipe.hash


def read_results(path: Path) -> None:
    from deepfsi.sweeps import read_results

    read_results(path)


def build_report(path: Path) -> None:
    import matplotlib.pyplot as plt

    from deepfsi.report import write_report

    try:
        write_report(path.parent)
    finally:
        plt.close("all")


def read_masks(path: Path) -> None:
    from deepfsi.jobs import read_matrix

    read_matrix(str(path))


def read_table(path: Path) -> None:
    from deepfsi.base.numeric import read_table

    read_table(path, ("scene", "label"))


def load_data(path: Path) -> None:
    from deepfsi.datasets import load_dataset

    load_dataset(path)


def load_small(path: Path) -> None:
    from deepfsi.datasets import load_dataset

    load_dataset(path.parents[1] if path.suffix == ".png" else path, size=4)


READERS = {
    "design": Reader("fixed.safetensors", read_design, (changed_tensors, mangled), 10),
    "nested design": Reader("nested.safetensors", read_design, (changed_tensors,)),
    "adaptive design": Reader("adaptive.safetensors", read_adaptive, (changed_tensors,)),
    "patches": Reader("patches.safetensors", read_design, (changed_tensors,)),
    "looks": Reader("looks.safetensors", read_shown_design, (changed_tensors,)),
    "loop": Reader("looks/loop.safetensors", read_loop, (changed_tensors, mangled)),
    "manifest": Reader("npy/manifest.json", read_patterns, (changed_json, mangled), 8),
    "manifest of looks": Reader("looks/manifest.json", read_patterns, (changed_json,)),
    "mirrors": Reader("npy/mirrors.npy", read_patterns, (mangled,), 2),
    "frames": Reader("npy/frames.npy", check_patterns, (mangled,), 1),
    "png frames": Reader("png/frames/0002.png", check_patterns, (mangled,), 1),
    "planes": Reader("planes/images/0000.bmp", check_patterns, (mangled,), 1),
    "bmp frames": Reader("bmp/frames/0002.bmp", check_patterns, (mangled,), 1),
    "table of planes": Reader("planes/patterns.csv", check_patterns, (mangled,), 1),
    "acquisition": Reader("run/acquisition.json", read_run, (changed_json, mangled)),
    "counts": Reader("run/counts.npz", read_run, (changed_zip, mangled)),
    "photons": Reader("run/photons.ptu", read_ptu, (mangled,), 8),
    "shown frames": Reader("live/shown.jsonl", read_live, (changed_lines, mangled)),
    "live counts": Reader("live/counts.npz", read_live, (changed_zip, mangled), 2),
    "calibration": Reader("calibration/calibration.json", read_calibration,
                          (changed_json, mangled)),
    "scenes": Reader("scenes.csv", read_scenes, (changed_table, mangled), 3),
    "camera": Reader("camera.toml", read_camera, (changed_toml, mangled)),
    "device": Reader("device/device.toml", lambda path: read_camera(path.parent / "camera.toml"),
                     (changed_toml,), 2),
    "detectors": Reader("device/map.npy", lambda path: read_camera(path.parent / "camera.toml"),
                        (mangled,), 1),
    "virtual camera": Reader("virtual.toml", read_virtual, (changed_toml, mangled)),
    "recipe": Reader("recipe.toml", read_recipe, (changed_toml, mangled)),
    "results": Reader("out/results.json", read_results, (changed_json, mangled)),
    "report": Reader("out/results.json", build_report, (changed_json,), 1),
    "report's design": Reader("out/designs/key.safetensors",
                              lambda path: build_report(path.parents[1] / "results.json"),
                              (changed_tensors,), 1),
    "index": Reader("published/designs.json", read_index, (changed_json, mangled)),
    "list of designs": Reader("designs.toml", read_list, (changed_toml, mangled)),
    "npz": Reader("data.npz", load_data, (changed_zip, changed_zip, mangled), 8),
    "zip": Reader("pictures.zip", load_small, (changed_zip, mangled), 5),
    "zip of images": Reader("pictures.zip", load_data, (changed_zip,), 2),
    "png": Reader("folder/a/0.png", load_small, (mangled,), 3),
    "cube": Reader("cube.mat", load_data, (mangled,), 3),
    "envi cube": Reader("envi/cube.hdr", load_data, (changed_envi, mangled), 2),
    "npy cube": Reader("plain.npy", load_data, (mangled,), 1),
    "npy masks": Reader("masks.npy", read_masks, (mangled,)),
    "mat masks": Reader("masks.mat", read_masks, (mangled,), 5),
    "old mat masks": Reader("old.mat", read_masks, (mangled,), 3),
    "hdf5 masks": Reader("masks.h5", read_masks, (mangled,)),
    "tiff masks": Reader("masks.tif", read_masks, (mangled,)),
    "csv": Reader("table.csv", read_table, (changed_table, mangled), 8),
    "text": Reader("table.txt", read_table, (changed_table, mangled), 3),
    "parquet": Reader("table.parquet", read_table, (mangled,)),
    "hdf5 table": Reader("table.h5", read_table, (mangled,), 2),
    "labels": Reader("folder/labels.csv", load_small, (changed_table, mangled), 2),
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


def make_samples(folder: Path) -> None:
    """Write a small valid file of each kind."""
    rng = np.random.default_rng(0)
    _designs(folder)
    _recordings(folder)
    _settings(folder)
    x = rng.integers(0, 255, (20, 4, 4), dtype=np.uint8)
    np.savez_compressed(folder / "data.npz", x=x, y=np.array(["a", "b"] * 10))
    _pictures(folder, x)
    _arrays(folder, rng)


PATCHES = {"patch": 2, "masks": 2, "hidden": (40, 128), "light": "column"}
PATCHES |= {"classifier": "vit", "precision": "float32"}


def _designs(folder: Path) -> None:
    from conftest import quick
    from deepfsi import from_arrays
    from deepfsi.camera import find_device
    from deepfsi.hardware.patterns import FrameSettings, export_patterns
    from deepfsi.lab import design_rails

    rng = np.random.default_rng(1)
    labels = np.arange(200) % 2
    scenes = 0.5 * rng.random((2, 4, 4))[labels] + 0.5 * rng.random((200, 4, 4))
    digits = from_arrays(scenes, labels, name="noise")
    quick(digits, "pca", masks=4, light="equal-dwell").save(folder / "fixed.safetensors")
    quick(digits, "pca", masks=4, nested=2).save(folder / "nested.safetensors")
    quick(digits, "adaptive", masks=3, light="free-dwell").save(folder / "adaptive.safetensors")
    quick(digits, **PATCHES).save(folder / "patches.safetensors")
    optics = {"light": "free-dwell", "rails": "single", "levels": 2, "looks": 2}
    quick(digits, masks=4, **optics).save(folder / "looks.safetensors")
    device = find_device("24x16")
    rails = design_rails(folder / "looks.safetensors")
    export_patterns(rails, FrameSettings(device, 1e-3), folder / "looks")
    rails = design_rails(folder / "fixed.safetensors")
    for kind in ("npy", "png", "bmp"):
        export_patterns(rails, FrameSettings(device, 1e-3, format=kind), folder / kind)
    packed = device.model_copy(update={"controller": "dlpc900"})
    export_patterns(rails, FrameSettings(packed, 1e-3, format="planes"), folder / "planes")


def _recordings(folder: Path) -> None:
    from deepfsi.hardware.counting import Scene, count_run
    from deepfsi.hardware.drivers import Setup
    from deepfsi.hardware.live import LiveCounts, plan_live, run_live
    from deepfsi.hardware.virtual import (
        CAMERAS,
        Latencies,
        RecordingSettings,
        VirtualCounter,
        VirtualOptics,
        VirtualProjector,
        arrival_rates,
        record_scenes,
    )

    scenes = np.random.default_rng(2).random((3, 4, 4))
    settings = RecordingSettings(CAMERAS["ideal"], 1e5, 5e-3)
    record_scenes(folder / "npy", scenes, ["a", "b", "c"], None, folder / "run", settings)
    count_run(folder / "run")
    rates = arrival_rates(folder / "looks", scenes, CAMERAS["ideal"], 1e6)
    setup = VirtualOptics(rates, CAMERAS["ideal"], Latencies(), 0)
    bench = Setup(VirtualProjector(setup), VirtualCounter(setup, (0,)), setup.display,
                  lambda: setup.now_s, Latencies().model_dump())  # fmt: skip
    named = tuple(Scene(name=str(k)) for k in range(3))
    planned = plan_live(folder / "looks", named, 10e-3)
    list(run_live(folder / "live", folder / "looks", planned, bench))
    LiveCounts.count(folder / "live")
    (folder / "calibration").mkdir()
    calibration = {
        "homography": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "residual": 0.1, "error": 0.01,
        "spots": 16, "shown": 16, "blur": [0.0, 0.1], "flat": [[1.0, 0.5], [0.5, 1.0]],
        "dead_time": {"seconds": 1e-8, "paralysable": False},
    }  # fmt: skip
    (folder / "calibration" / "calibration.json").write_text(json.dumps(calibration))
    (folder / "scenes.csv").write_text('name,label\n"a, b",x\nb,\nc,y\n')


def _settings(folder: Path) -> None:
    from shared.results import a_point, some_results

    camera = ('light = "free-dwell"', 'exposure = "10ms"', "flux = 1e6", "dark = 200",
              'dead_time = "20ns"', 'rails = "single"')  # fmt: skip
    (folder / "camera.toml").write_text("\n".join((*camera, 'detectors = "2x2"', "levels = 2")))
    (folder / "device").mkdir()
    named = 'device = "device.toml"\ndetectors = "map.npy"\n'
    (folder / "device" / "camera.toml").write_text("\n".join(camera) + "\n" + named)
    sizes = "columns = 24\nrows = 16\nshortest_us = 44\nsettle_us = 10.0\nplanes = 'BGR'\n"
    (folder / "device" / "device.toml").write_text(sizes + "controller = 'alp'\n")
    np.save(folder / "device" / "map.npy", np.arange(16) % 4)
    (folder / "virtual.toml").write_text("dark = 200\ndead_time_s = 2e-8\nefficiency = 0.5\n")
    recipe = ("data = 'digits'", "designs = ['pca', 'deepfsi']", "photons = [1e3, 1e4]",
              "masks = [3, 4]", "trials = 2", "[camera]", "light = ['column', 'equal-dwell']",
              "[training]", "epochs = 1", "hidden = [8, 8]", "[exposure]", "looks = 1")  # fmt: skip
    (folder / "recipe.toml").write_text("\n".join(recipe))
    wanted = ("[designs.one]", "recognises = 'it'", "data = 'digits'", "size = [8, 8]",
              "[designs.one.settings]", "camera = 'dmd'", "photons = 1e4", "masks = 4",
              "levels = 2", "hidden = [8]", "[data.digits]", "citation = 'a'",
              "licence = 'b'")  # fmt: skip
    (folder / "designs.toml").write_text("\n".join(wanted))
    entry = {"sha256": "0" * 64, "recognises": "it", "data": "digits", "photons": 1e4,
             "accuracy": 0.5, "low": 0.4, "high": 0.6, "recipe": "1" * 64}  # fmt: skip
    (folder / "published").mkdir()
    index = json.dumps({"schema_version": 1, "designs": {"one": entry}})
    (folder / "published" / "designs.json").write_text(index)
    (folder / "out" / "designs").mkdir(parents=True)
    points = [a_point(photons=photons, masks=4) for photons in (1e2, 1e4)]
    written = json.dumps(some_results(points, data={"image_shape": (4, 4)}).as_dict())
    (folder / "out" / "results.json").write_text(written)
    shutil.copy(folder / "fixed.safetensors", folder / "out" / "designs" / "key.safetensors")


def _pictures(folder: Path, x: np.ndarray) -> None:
    with zipfile.ZipFile(folder / "pictures.zip", "w") as archive:
        for place, scene in enumerate(x):
            label, kind = "ab"[place % 2], ("png", "bmp", "jpg", "gif", "tif")[place % 5]
            path = folder / "folder" / label / f"{place}.{kind}"
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(scene).save(path)
            archive.write(path, f"{label}/{path.name}")
    names = sorted((folder / "folder").glob("*/*.*"))
    lines = [f"{path.parent.name}/{path.name},{path.parent.name}" for path in names]
    (folder / "folder" / "labels.csv").write_text("\n".join(lines))
    pages = [Image.fromarray(scene) for scene in x[:3]]
    pages[0].save(folder / "masks.tif", save_all=True, append_images=pages[1:])


def _arrays(folder: Path, rng: np.random.Generator) -> None:
    import h5py
    import polars
    from scipy.io import savemat
    from spectral.io import envi

    masks, table = rng.random((3, 4, 4)), rng.integers(0, 50, (5, 6)).astype(float)
    np.save(folder / "masks.npy", masks)
    savemat(folder / "masks.mat", {"masks": masks, "other": "text"}, do_compression=True)
    savemat(folder / "old.mat", {"masks": masks[0]}, format="4")
    cube, labels = rng.random((12, 12, 3)), rng.integers(0, 3, (12, 12))
    savemat(folder / "cube.mat", {"cube": cube})
    savemat(folder / "cube_gt.mat", {"labels": labels})
    (folder / "envi").mkdir()
    for name, held in (("cube", cube.astype("<f4")), ("cube_gt", labels[..., None].astype("<f4"))):
        envi.save_image(str(folder / "envi" / f"{name}.hdr"), held, interleave="bip")
    np.save(folder / "plain.npy", cube)
    np.save(folder / "plain_gt.npy", labels)
    for name, held in (("masks", masks), ("table", table)):
        with h5py.File(folder / f"{name}.h5", "w") as file:
            file.create_dataset("counts", data=held, compression="gzip")
    np.savetxt(folder / "table.txt", table)
    frame = polars.DataFrame(table, schema=[f"mask{k}" for k in range(6)], orient="row")
    frame = frame.with_columns(scene=polars.Series(list("abcde")))
    frame.write_csv(folder / "table.csv")
    frame.write_parquet(folder / "table.parquet")


def drawn(reader: Reader, seed: int, name: str, content: bytes) -> bytes:
    """Input of a seed."""
    rng = random.Random(f"{name} {seed}")
    return rng.choice(reader.mutations)(rng, content)
