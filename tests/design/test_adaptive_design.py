"""Laws of designs of adaptive masks: their files, tests and stops, and what refuses them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from deepfsi import Camera, Design, evaluate, learn, load_design
from deepfsi.base import InputError
from deepfsi.evaluation import stop
from shared.design_files import header_of, rewrite

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


def test_light_of_each_look_is_of_its_budget(adaptive, few):
    [found] = evaluate(adaptive, few, PHOTONS, draws=3)
    assert len(found.photons_per_mask) == LOOKS
    # the test scenes are as bright as the training's to a tenth; half of the light is hardly passed
    assert found.counts == pytest.approx(PHOTONS * found.throughput, rel=0.2)
    assert 0.05 < found.throughput < 0.6


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


def test_dark_counts_go_with_tests_and_stops(few, kept):
    made = learn(kept, design="adaptive", masks=3, photons=1e3, camera=Camera(dark=300.0))
    bright = learn(kept, design="adaptive", masks=3, photons=1e3)
    dark, none = (evaluate(each, few, 1e3, draws=3)[0] for each in (made, bright))
    # of light alone, of which brighter masks are better beside 300 dark counts
    assert none.counts < dark.counts < none.counts + 100
    assert dark.accuracy < none.accuracy
    found = stop(made, few, 1e3, threshold=1.0, draws=3)
    # other draws of the same noise: within five standard errors of 180 answers
    assert found.whole.mean == pytest.approx(dark.accuracy, abs=5 * np.sqrt(0.25 / 180))


def test_noise_that_is_not_of_photons_is_refused_in_a_test(adaptive, few):
    with pytest.raises(InputError, match="photon counts"):
        evaluate(adaptive, few, PHOTONS, noise="gaussian", sigma=2.0)


def test_counts_of_a_training_are_reached(kept):
    made = learn(kept, design="adaptive", masks=2, counts=1000.0)
    photons = made.info["job"]["photons"]
    assert photons * float(made.shares.sum()) == pytest.approx(1000, rel=0.02)


def test_the_header_holds_no_scene(adaptive, tmp_path):
    path = adaptive.save(tmp_path / "a.safetensors")
    assert len(str(header_of(path))) < 10_000
    known = adaptive.prior_exposure.prior
    assert path.stat().st_size < 1.5 * (known.coefficients.numel() + 4 * known.components.numel())
    assert np.isclose(sum(adaptive.prior_exposure.settings.shares), 1.0)
