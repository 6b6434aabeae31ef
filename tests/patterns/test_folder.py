"""Folder of patterns: it holds what was designed, mirror by mirror, and damage is found."""

import json
import math
import tempfile
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import torch
from pattern_samples import BOARD, SMALL, UNEQUAL, every_format, export, grey
from scipy.linalg import hadamard

from conftest import FLOAT32, OPTICS
from deepfsi.base.errors import InputError
from deepfsi.camera.device import DEVICES, Device, find_device
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.frames import make_frames, unpack
from deepfsi.physics.laws import ROUNDING_SLACK, light_law


@pytest.mark.parametrize(
    ("design", "light", "rails"),
    [
        *(("deepfsi", light, rails) for light, rails in OPTICS),
        ("hadamard", "column", "dual"),  # three levels
        ("raster", "free-dwell", "dual"),  # one lit pixel
        ("s-matrix", "equal-dwell", "dual"),  # two levels
        ("random", "two-arm", "dual"),
    ],
)
def test_the_realised_matrix_is_the_design_in_steps_of_each_peak(
    made, tmp_path, design, light, rails
):
    given = made(design, light, rails).rails.stacked.double()
    device = find_device("64x48")
    shown = export(
        tmp_path / "p", given.numpy(), light, image_shape=(8, 8), device=device, format="raw"
    )
    manifest = shown.manifest
    # `quantise` also mends what rounding breaks of a column design; dimming leaves no need for it
    law = light if LIGHT_LAWS[light].one_device else "free-dwell"
    wanted = light_law(law).quantise(given, manifest.grid.mirrors + 1) * manifest.dimmed
    tolerance = FLOAT32 if light == "two-arm" else 1e-12  # arms sum to one time in float32 only
    assert np.allclose(shown.rails, wanted.numpy(), rtol=tolerance, atol=1e-15)

    per_rail = given.sum(dim=0, keepdim=True) if light == "two-arm" else given
    lit = per_rail.amax(dim=-1).T
    assert len(manifest.frames) == int((lit > 0).sum()) + 4
    assert manifest.shares == pytest.approx((lit[lit > 0] * manifest.dimmed).tolist(), rel=1e-12)
    assert manifest.shares.sum() <= 1 + 1e-12
    assert light_law(law).excess(torch.from_numpy(shown.rails)) <= FLOAT32
    if LIGHT_LAWS[light].one_device:
        assert manifest.dimmed >= 1 - ROUNDING_SLACK
    else:
        assert manifest.dimmed == pytest.approx(min(1, 1 / float(lit.sum())), rel=1e-12)
    assert np.array_equal(Patterns.read(tmp_path / "p").check().on, shown.on)


@pytest.mark.parametrize("form", ["npy", "bmp", "raw"])
@pytest.mark.parametrize("device", [SMALL, find_device("64x32")], ids=lambda one: one.name)
def test_what_is_read_back_is_what_was_written(tmp_path, form, device):
    written = export(tmp_path / "p", device=device, format=form, file=b"masks")
    read = Patterns.read(tmp_path / "p")
    assert read.manifest == written.manifest
    assert read.on.dtype == np.uint32
    assert np.array_equal(read.on, written.on)
    assert np.array_equal(Patterns.read(tmp_path / "p").check().rails, written.rails)
    assert (tmp_path / "p" / "design.safetensors").read_bytes() == b"masks"
    frames = list(Patterns.read(tmp_path / "p").frames())
    made = make_frames(written.on, device, written.manifest.grid)
    assert all(np.array_equal(*pair) for pair in zip(frames[2:-2], made, strict=True))
    grid = written.manifest.grid
    cells = np.zeros((device.rows, device.columns), dtype=bool)
    cells[
        grid.top : grid.top + grid.down * grid.height,
        grid.left : grid.left + grid.across * grid.width,
    ] = True  # mirrors beyond the cells stay OFF: their light is none of the scene's
    for place, lit in ((0, True), (1, False), (-2, True), (-1, False)):
        assert np.array_equal(unpack(frames[place], device), cells & lit)


def test_a_long_sequence_needs_the_memory_of_a_few_frames():
    device, signed = DEVICES["dlp7000"], hadamard(1024).astype(np.float32) / 2047
    rails = np.stack([signed.clip(0), (-signed).clip(0)])
    whole = 2051 * np.prod(device.frame_shape)
    with tempfile.TemporaryDirectory() as folder:
        tracemalloc.start()
        export(Path(folder) / "p", rails, "equal-dwell", image_shape=(32, 32), device=device)
        patterns = Patterns.read(Path(folder) / "p")
        known = tracemalloc.get_traced_memory()[1]
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        count = sum(1 for _ in Patterns.read(Path(folder) / "p").frames())
        reading = tracemalloc.get_traced_memory()[1] - before
        tracemalloc.stop()
    assert count == 2051
    # 4 bytes a cell and frame for the counts of what was written and what was read, a manifest of
    # some kB a frame, and no more than 32 frames
    some = 2051 * 3e3 + 32 * np.prod(device.frame_shape)
    assert known < 2 * patterns.on.nbytes + some < whole / 5
    assert reading < patterns.on.nbytes + some


FILES = {
    "npy": "frames.npy",
    "raw": "frames.bin",
    "bmp": "frames/0003.bmp",
    "planes": "images/0000.bmp",
}


@every_format
def test_a_changed_mirror_a_cut_file_and_a_missing_one_are_found(tmp_path, form):
    folder = tmp_path / "p"
    export(folder, device=BOARD, format=form)
    for path in (folder / FILES[form], folder / "patterns.csv"):
        whole = path.read_bytes()
        for content in (whole[:-9] + bytes([whole[-9] ^ 0x10]) + whole[-8:], whole[:-1], b""):
            path.write_bytes(content)
            with pytest.raises(InputError, match=rf"{path.name} is not what was exported"):
                Patterns.read(folder).check()
        path.unlink()
        with pytest.raises(InputError, match=rf"{path.name} is missing"):
            Patterns.read(folder).check()
        path.write_bytes(whole)


def change(folder: Path, **changes: object) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def test_a_changed_manifest_is_found(tmp_path):
    export(tmp_path / "p")
    frames = json.loads((tmp_path / "p" / "manifest.json").read_text())["frames"]
    frames[3]["share"] *= 0.99
    change(tmp_path / "p", frames=frames)
    with pytest.raises(InputError, match=r"manifest\.json was changed"):
        Patterns.read(tmp_path / "p")
    change(tmp_path / "p", sha256=None)
    assert Patterns.read(tmp_path / "p").manifest.frames[3].share == frames[3]["share"]


def test_another_design_beside_the_frames_is_found(tmp_path):
    export(tmp_path / "p", file=b"masks")
    path = tmp_path / "p" / "design.safetensors"
    path.write_bytes(b"others")
    with pytest.raises(InputError, match="not the one that was exported"):
        Patterns.read(tmp_path / "p").check()
    path.unlink()
    with pytest.raises(InputError, match="is missing"):
        Patterns.read(tmp_path / "p").check()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rails": np.zeros((2, 3, 16))}, "every mask is dark"),
        ({"light": "two-arm"}, "do not sum to one time"),
        ({"dwell_s": math.inf}, "dwell inf"),
        ({"dwell_s": 999, "rails": UNEQUAL}, "export again with another --exposure"),
        ({"format": "bin"}, "give one of npy, raw, bmp"),
        ({"device": find_device("3x3")}, "do not fit"),
        ({"device": Device(name="slow", columns=8, rows=8, settle_us=1e3)}, "leave no time after"),
    ],
)
def test_what_cannot_be_shown_is_refused_before_anything_is_written(tmp_path, changes, message):
    with pytest.raises(InputError, match=message):
        export(tmp_path / "p", **changes)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("dwell", "us"), [(7e-4, 700), (123e-6, 123), (70.01e-6, 71), (1.001e-3, 1001), (1e-6, 44)]
)
def test_equal_dwell_holds_every_frame_for_whole_microseconds_that_the_device_can(
    tmp_path, dwell, us
):
    """Rounded up, but not by floating point."""
    manifest = export(tmp_path / "p", grey() / 20, "equal-dwell", dwell_s=dwell).manifest
    assert {frame.picture_us for frame in manifest.frames} == {us}


def test_frames_of_a_video_last_whole_refreshes(tmp_path):
    """Each as few as hold its time, the all-ON and all-OFF ones, too."""
    usual, video = (
        export(
            tmp_path / f"{step}", grey() / 20, "free-dwell",
            device=SMALL.model_copy(update={"step_us": step}), dwell_s=40e-3,
        ).manifest
        for step in (1, 16667)
    )  # fmt: skip
    for any_time, whole in zip(usual.frames, video.frames, strict=True):
        assert whole.picture_us % 16667 == 0
        assert 0 <= whole.picture_us - any_time.picture_us < 16667
