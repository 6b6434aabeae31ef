"""Patterns on the command line: of named devices, one's own, and what they cannot show."""

import json

import pytest

from deepfsi import learn


@pytest.fixture(scope="module")
def ready(tmp_path_factory, digits):
    """Design that chooses among 60 masks."""
    words = {"design": "adaptive", "masks": 3, "photons": 1e4}
    made = learn(digits.hold_out(900), **words, training={"dictionary": 60})
    return made.save(tmp_path_factory.mktemp("ready") / "a.safetensors")


@pytest.mark.parametrize(
    ("held", "said"),
    [
        (64, None),
        (63, "64 frames do not fit small, whose controller holds 63: use fewer masks"),
    ],
)  # fmt: skip
def test_a_dictionary_is_exported_whole_or_not_at_all(call, ready, tmp_path, held, said):
    """One line, exit code 2 and no folder where the device does not hold all masks."""
    device = tmp_path / "small.toml"
    device.write_text(f"columns = 64\nrows = 48\npatterns = {held}\n")
    out = tmp_path / "patterns"
    code, told, errors = call("dmd", "export", ready, "--dmd", device, "-o", out)
    if said is None:
        assert code == 0
        assert "60 frames of masks" in told
        assert "3 looks, each at one of these masks by its index" in told
        assert len(json.loads((out / "manifest.json").read_text())["frames"]) == 64
    else:
        assert (code, errors.count("\n")) == (2, 1)
        assert said in errors
        assert [each.name for each in tmp_path.iterdir()] == ["small.toml"]
