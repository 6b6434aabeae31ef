"""Manifest: times of pictures as asked and as the device can; several looks, shown once."""

import json

import numpy as np
import pytest
from pattern_samples import export, grey

from conftest import quick
from deepfsi import Design
from deepfsi.base import InputError
from deepfsi.designfile import loop_bytes
from deepfsi.hardware.patterns import GatePlan, check_patterns, read_patterns
from shared.design_files import file_of


@pytest.mark.parametrize(
    ("dwell", "us"), [(7e-4, 700), (123e-6, 123), (70.01e-6, 71), (1.001e-3, 1001), (1e-6, 44)]
)
def test_equal_dwell_holds_every_frame_for_whole_microseconds_that_the_device_can(
    tmp_path, dwell, us
):
    """Rounded up, but not by floating point."""
    manifest = export(tmp_path / "p", grey() / 20, "equal-dwell", dwell_s=dwell).manifest
    assert {frame.picture_us for frame in manifest.frames} == {us}


def test_pictures_share_out_what_is_left_beyond_settling(tmp_path):
    manifest = export(tmp_path / "p", dwell_s=5e-3).manifest
    pictures = np.array([frame.picture_us for frame in manifest.frames])
    shown = pictures[manifest.shown]
    wanted = 10 + (5000 - 10) * 10 * manifest.shares / manifest.shares.sum()
    assert (shown >= np.maximum(wanted, 44) - 1e-6).all()
    assert (shown < np.maximum(wanted, 44) + 1).all()
    assert {*pictures[[0, 1, -2, -1]]} == {5000}
    # so all frames allow one exposure, all that is left of their clock
    longest = (5000e-6 - 10e-6) * 10 / manifest.shares.sum()
    assert GatePlan.of(manifest, longest).repeats == 1


LOOKS = 3
OPTICS = {
    "single": {"light": "free-dwell", "rails": "single", "levels": 2},
    "dual": {"light": "free-dwell", "rails": "dual", "readout": "both"},
    "two arms": {"light": "two-arm", "readout": "both"},
}


@pytest.fixture(scope="module", params=OPTICS)
def patterns(request, digits, tmp_path_factory):
    """Folder of the design and its patterns, exported by the command."""
    from click.testing import CliRunner

    from deepfsi.cli import app

    folder = tmp_path_factory.mktemp("looks")
    quick(digits, masks=6, looks=LOOKS, photons=1e3, **OPTICS[request.param]).save(
        folder / "looks.safetensors"
    )
    words = ["dmd", "export", folder / "looks.safetensors", "--device", "64x48", "--json"]
    done = CliRunner().invoke(app, [*map(str, words), "-o", str(folder / "patterns")])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["looks"] == LOOKS
    assert told["uncounted"] is told["longest_exposure_s"] is None
    return folder


def test_each_frame_is_there_once_with_the_first_look_s_time(patterns):
    design = Design.load(patterns / "looks.safetensors")
    manifest = check_patterns(patterns / "patterns").manifest
    looks, file = manifest.looks, file_of(design)
    rails = [(manifest.frames[at].mask, manifest.frames[at].rail) for at in manifest.shown]
    assert len(set(rails)) == len(rails)
    assert (looks.count, looks.each_rail) == (LOOKS, design.exposure.dwells.each_rail)
    np.testing.assert_allclose(looks.first, file.first_dwell)
    assert looks.shortest == design.exposure.shortest
    places = looks.places(
        np.array([mask for mask, _ in rails]), np.array([rail == "minus" for _, rail in rails])
    )
    us = manifest.picture_s[manifest.shown] * 1e6
    first = np.array(looks.first)[places]
    rest = us - manifest.device.settle_us
    long = us > manifest.device.shortest_us
    assert long.any()
    ratio = rest[long] / first[long]
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=0.02)  # times are whole microseconds
    assert us.mean() == pytest.approx(1000, rel=0.01)


def test_the_loop_stands_beside_them(patterns):
    design = Design.load(patterns / "looks.safetensors")
    folder = patterns / "patterns"
    assert (folder / "loop.safetensors").read_bytes() == loop_bytes(file_of(design))
    content = bytearray((folder / "loop.safetensors").read_bytes())
    content[-1] ^= 1
    (folder / "loop.safetensors").write_bytes(content)
    with pytest.raises(InputError, match=r"loop\.safetensors is not the one"):
        check_patterns(folder)
    content[-1] ^= 1
    (folder / "loop.safetensors").write_bytes(content)


def test_they_realise_the_design(patterns):
    design = Design.load(patterns / "looks.safetensors")
    shown = design.as_shown(*read_patterns(patterns / "patterns").realised)
    step = float(design.rails.stacked.max()) / 47  # cells of 8 x 6 mirrors
    np.testing.assert_allclose(shown.rails.stacked, design.rails.stacked, atol=step)


def test_a_first_look_of_other_masks_is_refused(patterns):
    from deepfsi.hardware.patterns import Manifest

    told = json.loads((patterns / "patterns/manifest.json").read_text())
    told["looks"]["first"] = [*told["looks"]["first"][:-2], sum(told["looks"]["first"][-2:])]
    with pytest.raises(ValueError, match="other frames"):
        Manifest.model_validate(told)
    told["looks"]["first"] = [2 * each for each in told["looks"]["first"]]
    with pytest.raises(ValueError, match="1/3 together"):
        Manifest.model_validate(told)
