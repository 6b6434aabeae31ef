"""Manifest: times of pictures as asked and as the device can; several looks, shown once."""

import json

import pytest
from pattern_samples import export, grey

from conftest import quick


@pytest.mark.parametrize(
    ("dwell", "us"), [(7e-4, 700), (123e-6, 123), (70.01e-6, 71), (1.001e-3, 1001), (1e-6, 44)]
)
def test_equal_dwell_holds_every_frame_for_whole_microseconds_that_the_device_can(
    tmp_path, dwell, us
):
    """Rounded up, but not by floating point."""
    manifest = export(tmp_path / "p", grey() / 20, "equal-dwell", dwell_s=dwell).manifest
    assert {frame.picture_us for frame in manifest.frames} == {us}


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


def test_a_first_look_of_other_masks_is_refused(patterns):
    from deepfsi.hardware.patterns import Manifest

    told = json.loads((patterns / "patterns/manifest.json").read_text())
    told["looks"]["first"] = [*told["looks"]["first"][:-2], sum(told["looks"]["first"][-2:])]
    with pytest.raises(ValueError, match="other frames"):
        Manifest.model_validate(told)
    told["looks"]["first"] = [2 * each for each in told["looks"]["first"]]
    with pytest.raises(ValueError, match="1/3 together"):
        Manifest.model_validate(told)
