"""Commands on adaptive masks: made, tested; refused where masks must be known."""

import json

import pytest

from deepfsi import learn, load_design, predict
from deepfsi.datasets.display import write_display


@pytest.fixture(scope="module")
def file(tmp_path_factory, digits):
    made = learn(digits.hold_out(900), design="adaptive", masks=3, photons=1e4)
    return made.save(tmp_path_factory.mktemp("adaptive") / "a.safetensors")


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
        (63, "64 frames do not fit small, whose controller holds 63: learn the design with "
         "--dictionary of 59 at most, or use a device that holds them, such as dlp7000"),
    ],
)  # fmt: skip
def test_a_dictionary_is_exported_whole_or_not_at_all(call, ready, tmp_path, held, said):
    """One line, exit code 2 and no folder where the device does not hold all masks."""
    device = tmp_path / "small.toml"
    device.write_text(f"columns = 64\nrows = 48\npatterns = {held}\n")
    out = tmp_path / "patterns"
    code, told, errors = call("dmd", "export", ready, "--device", device, "-o", out)
    if said is None:
        assert code == 0
        assert "60 frames of masks" in told
        assert "3 looks, each at one of these masks by its index" in told
        assert len(json.loads((out / "manifest.json").read_text())["frames"]) == 64
    else:
        assert (code, errors.count("\n")) == (2, 1)
        assert said in errors
        assert [each.name for each in tmp_path.iterdir()] == ["small.toml"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("export FILE -o a.onnx", "makes its masks while the camera looks"),
        ("camera classify FILE counts.csv --photons 1e4", "makes its masks while the camera looks"),
        ("evaluate FILE --photons 1e4 --ideal", "leave --ideal out"),
    ],
)
def test_what_needs_masks_beforehand_refuses_it(refuse, file, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    assert said in refuse(*words.replace("FILE", str(file)).split())


def test_it_classifies_pictures_as_the_function_does(done, file, digits, tmp_path):
    """Masks are made for each picture while it is exposed."""
    write_display(digits, tmp_path / "p", per_class=1)
    told = json.loads(done("predict", file, tmp_path / "p", "--photons", "1e4", "--json"))
    found = predict(load_design(file), tmp_path / "p", 1e4)
    assert [each["class"] for each in told["pictures"]] == [p.predicted for p in found.pictures]
    assert told["score"]["new"] == found.score.new.as_dict()
