"""Laws of a live run with masks of a dictionary: frames on the device, shown by their index."""

import numpy as np
import pytest

from deepfsi import InputError, load_design
from deepfsi.adaptive.dictionary import DictionaryPosterior
from deepfsi.lab import results as frame_log
from deepfsi.lab.design_data import design_rails
from deepfsi.lab.devices import virtual_setup
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.frames import unpack
from shared.live_samples import (
    DEVICE,
    EXPOSURE_S,
    FLUX,
    Counted,
    check_accuracy,
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
    assert [manifest.frames[at].mask for at in manifest.mask_frames] == list(range(MASKS))
    grid = manifest.grid
    for frame, mask in zip(list(Patterns.read(patterns).frames())[2:-2], masks, strict=True):
        cells = unpack(frame, DEVICE)[grid.window].reshape(8, grid.height, 8, grid.width)
        assert (cells == mask.reshape(8, 1, 8, 1)).all()
    np.testing.assert_array_equal(read.fractions, masks)


def test_each_look_shows_the_frame_of_the_mask_that_is_chosen(
    digits, patterns, tmp_path, monkeypatch
):
    """By its index; nothing is loaded."""
    x, scenes = scenes_of(digits, 2)
    run = planned(patterns, scenes)
    devices = virtual_setup(run.patterns, x, run.settings)
    shown, chosen, projector = [], [], devices.projector
    choose, show = DictionaryPosterior.next_masks, projector.show

    def choosing(state, *given):
        chosen.extend(state.dictionary.indices(masks := choose(state, *given)))
        return masks

    def showing(frames, dwells_s):
        shown.append(frames.tolist())
        show(frames, dwells_s)

    monkeypatch.setattr(DictionaryPosterior, "next_masks", choosing)
    projector.show, projector.replace = showing, None  # a load would fail
    list(run.steps(tmp_path / "run", devices))
    looks = [frames for frames in shown if frames != [0, OFF, OFF]]
    assert looks == [[row + 2, OFF] for row in chosen]
    logged = [each for scene in frame_log.read_log(tmp_path / "run") for each in scene.lists[1:-1]]
    assert [[*each.frames, OFF] for each in logged] == looks
    assert len(looks) == 2 * LOOKS
    assert all(each.masks == () for each in logged)
    assert all(len({*map(tuple, some)}) > LOOKS / 2 for some in (looks[:LOOKS], looks[LOOKS:]))


def test_decisions_are_those_of_the_design(digits, design, patterns, tmp_path, monkeypatch):
    """Accuracy within the noise of both; the photon file holds what was counted."""
    counted = Counted(monkeypatch)
    decided = live(tmp_path / "run", patterns, digits, 50)
    counted.check_file(tmp_path / "run")
    counts = check_accuracy(decided, design, digits, FLUX * EXPOSURE_S)
    looks = [each.sum() for each in counted.lists if len(each) == 1]
    # scenes are the same, masks follow from other counts
    assert sum(looks) / 50 == pytest.approx(counts, rel=0.05)


def test_a_device_that_cannot_hold_the_masks_is_refused(patterns, tmp_path):
    rails = design_rails(patterns.parent / "adaptive.safetensors")
    device = DEVICE.model_copy(update={"patterns": MASKS + 3})
    with pytest.raises(InputError, match=r"304 frames do not fit 64x48, .*a smaller `dictionary`"):
        Patterns.from_rails(rails, device, 1e-3).write(tmp_path / "other")
    assert not list(tmp_path.iterdir())
