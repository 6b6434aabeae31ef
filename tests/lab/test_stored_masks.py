"""Laws of a live run with masks of a dictionary: frames on the device, shown by their index."""

from dataclasses import replace

import numpy as np
import pytest

from deepfsi import evaluate, load_design
from deepfsi.base.errors import InputError
from deepfsi.lab import adaptive_looks
from deepfsi.lab import results as frame_log
from deepfsi.lab.design_data import design_rails
from deepfsi.lab.devices import virtual_setup
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.frames import make_frame, unpack
from shared.live_samples import (
    DEVICE,
    EXPOSURE_S,
    FLUX,
    Counted,
    live,
    make_patterns,
    planned,
    scenes_of,
)

LOOKS, MASKS = 12, 300
OFF = 1


@pytest.fixture(scope="module")
def patterns(digits, tmp_path_factory):
    """Patterns of digits at 10⁴ photons."""
    settings = {"masks": LOOKS, "training": {"dictionary": MASKS}}
    return make_patterns(tmp_path_factory.mktemp("stored"), digits, **settings)


@pytest.fixture(scope="module")
def design(patterns):
    return load_design(patterns.parent / "adaptive.safetensors")


def test_the_folder_holds_the_dictionary_once_mask_by_mask(design, patterns):
    """Frame p + 2 is the picture of mask p, each mirror of a cell ON or OFF with its pixel."""
    masks = design.prior_exposure.dictionary.masks.numpy().astype(bool)
    read = Patterns.read(patterns)
    manifest = read.manifest
    assert [manifest.frames[at].mask for at in manifest.shown] == list(range(MASKS))
    grid = manifest.grid
    for frame, mask in zip(list(Patterns.read(patterns).frames())[2:-2], masks, strict=True):
        cells = unpack(frame, DEVICE)[grid.window].reshape(8, grid.height, 8, grid.width)
        assert (cells == mask.reshape(8, 1, 8, 1)).all()
    np.testing.assert_array_equal(read.fractions, masks)


def test_frames_that_are_shown_are_the_exported_ones_bit_for_bit(
    digits, patterns, tmp_path, monkeypatch
):
    """Index p shows picture p of the folder, of the mask that the posterior asks for; no load."""
    x, scenes = scenes_of(digits, 2)
    run = planned(patterns, scenes)
    devices = virtual_setup(run.patterns, x, run.settings)
    shown, chosen, projector = [], [], devices.projector
    choose = adaptive_looks.DictionaryPosterior.choose
    monkeypatch.setattr(
        adaptive_looks.DictionaryPosterior,
        "choose",
        lambda state: (chosen.extend(rows := choose(state)), rows)[1],
    )
    show = projector.show
    projector.show = lambda frames, dwells_s: (
        shown.append(frames.tolist()),
        show(frames, dwells_s),
    )
    projector.replace = None  # a load would fail
    list(run.steps(tmp_path / "run", devices))
    pictures = list(Patterns.read(patterns).frames())
    manifest = Patterns.read(patterns).manifest
    asked = [frames for frames in shown if frames != [0, OFF, OFF]]
    for scene in frame_log.read_log(tmp_path / "run"):
        looked = scene.lists[1:-1]
        assert len(looked) == LOOKS
        assert len({each.frames for each in looked}) > LOOKS / 2
        for logged in looked:
            [frame] = logged.frames
            assert logged.masks == ()
            assert asked.pop(0) == [frame, OFF]
            assert chosen.pop(0) == frame - 2
            mask = run.looks.stored.masks[frame - 2].bool().numpy()
            assert np.array_equal(pictures[frame], make_frame(mask, manifest.device, manifest.grid))
    assert not asked


def test_decisions_are_those_of_the_design(digits, design, patterns, tmp_path, monkeypatch):
    """Accuracy within the noise of both; the photon file holds what was counted."""
    counted = Counted(monkeypatch)
    decided = live(tmp_path / "run", patterns, digits, 100)
    counted.check_file(tmp_path / "run")
    last = [each.answer for each in decided if each.answer]
    right = np.mean([each.predicted == each.label for each in last if each.predicted])
    few = replace(digits, x_test=digits.x_test[:100], y_test=digits.y_test[:100])
    [wanted] = evaluate(design, few, FLUX * EXPOSURE_S, draws=2)
    assert abs(right - wanted.accuracy) < 5 * np.sqrt(
        2 * wanted.accuracy * (1 - wanted.accuracy) / 100
    )
    looks = [each.sum() for each in counted.lists if len(each) == 1]
    # scenes are the same, masks follow from other counts
    assert sum(looks) / 100 == pytest.approx(wanted.counts, rel=0.05)
    faults = [fault.kind for each in last for fault in each.faults]
    assert set(faults) <= {"unsure"}
    assert len(faults) <= 11  # 0.04 of 100 at most, at a chance of 1 in 1000


def test_a_device_that_cannot_hold_the_masks_is_refused(patterns, tmp_path):
    rails = design_rails(patterns.parent / "adaptive.safetensors")
    device = DEVICE.model_copy(update={"patterns": MASKS + 3})
    with pytest.raises(InputError, match=r"304 frames do not fit 64x48, .*a smaller `dictionary`"):
        Patterns.from_rails(rails, device, 1e-3).write(tmp_path / "other")
    assert not list(tmp_path.iterdir())
