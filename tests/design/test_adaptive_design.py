"""Laws of designs of adaptive masks: their files, tests and stops, and what refuses them."""

from dataclasses import replace

import pytest
import torch

from deepfsi import Camera, Design, evaluate, learn, load_design
from deepfsi.base import InputError
from deepfsi.evaluation import stop
from shared.design_files import rewrite

LOOKS, PHOTONS, HELD_OUT = 6, 1e4, 200


@pytest.fixture(scope="module")
def few(digits):
    """Give digits with few scenes."""
    test = {"x_test": digits.x_test[:60], "y_test": digits.y_test[:60]}
    return replace(digits, x_train=digits.x_train[:600], y_train=digits.y_train[:600], **test)


@pytest.fixture(scope="module")
def kept(few):
    return few.hold_out(HELD_OUT)


@pytest.fixture(scope="module")
def adaptive(kept):
    return learn(kept, design="adaptive", masks=LOOKS, photons=PHOTONS)


def test_a_file_gives_the_design_back(adaptive, few, tmp_path):
    path = adaptive.save(tmp_path / "a.safetensors")
    back, same = load_design(path), Design.load(path)
    assert back.exposure.makes_masks
    assert back.to_bytes() == same.to_bytes() == path.read_bytes()
    assert (back.prior_exposure.settings, back.classes, back.info) == (
        adaptive.prior_exposure.settings, adaptive.classes, adaptive.info
    )  # fmt: skip
    found, wanted = (evaluate(each, few, PHOTONS, draws=2)[0] for each in (back, adaptive))
    # scenes are kept in 8 bits: some answers may change, of the same noise and few of them
    assert found.accuracy == pytest.approx(wanted.accuracy, abs=0.05)
    assert evaluate(back, few, PHOTONS) == evaluate(same, few, PHOTONS)


def shorter(header, tensors):
    tensors["shares"] = tensors["shares"][:-1]


def lost(header, tensors):
    del tensors["levels"]


def other_shape(header, tensors):
    header["image_shape"] = [9, 9]


def not_finite(header, tensors):
    tensors["mean"][0] = torch.nan


def fewer_classes(header, tensors):
    header["classes"] = header["classes"][:-1]


def more_scenes(header, tensors):
    tensors["sizes"][0] += 1


def negative_sizes(header, tensors):
    tensors["sizes"][:2] += torch.tensor([-10_000, 10_000])


def wide(header, tensors):
    tensors["components"] = tensors["components"].double()


def no_photons(header, tensors):
    tensors["numbers"][0] = 0.0


def nobody(header, tensors):
    tensors["members"][0] = 0


CHANGES = [
    shorter, lost, other_shape, not_finite, fewer_classes, more_scenes, negative_sizes, wide,
    no_photons, nobody,
]  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_a_damaged_file_is_refused_in_one_line(adaptive, tmp_path, change):
    path = adaptive.save(tmp_path / "a.safetensors")
    rewrite(path, change)
    with pytest.raises(InputError, match="not a whole deepfsi design file") as error:
        load_design(path)
    assert "\n" not in str(error.value)


def test_answers_are_good_and_better_with_more_light(adaptive, few):
    dim, bright = evaluate(adaptive, few, [1e2, 1e4], draws=2)
    assert dim.accuracy + 0.2 < bright.accuracy
    assert bright.accuracy > 0.8


def test_an_exposure_that_never_stops_is_a_whole_one(adaptive, few):
    found = stop(adaptive, few, PHOTONS, threshold=1.0, draws=1)
    assert found.used.mean == pytest.approx(1.0)
    assert found.stopped.mean == found.whole.mean
    assert found.rule.after == tuple(range(1, LOOKS + 1))
    early = stop(adaptive, few, PHOTONS, threshold=0.9, draws=1)
    assert early.used.mean < 0.95 < 1.0


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"camera": "paper"}, "one device, not column"),
        ({"camera": Camera(noise="gaussian", sigma=2.0)}, "photon counts"),
        ({"exposure": {"looks": 2}}, "a look each"),
        ({"training": {"classifier": torch.nn.Linear}}, "leave `classifier` out"),
        ({"masks": 65}, "1 to 64"),
        (
            {"camera": Camera(device="dlp7000", exposure="1ms"), "masks": 50},
            "give at most [0-9]+ masks",
        ),
    ],
)
def test_what_adaptive_masks_cannot_do_is_refused(few, settings, words):
    given = {"design": "adaptive", "masks": LOOKS, "photons": PHOTONS} | settings
    with pytest.raises(InputError, match=words) as error:
        learn(few, **given)
    assert "\n" not in str(error.value)
