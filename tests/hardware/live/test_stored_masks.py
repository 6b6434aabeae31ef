"""Laws of a live run with masks of a dictionary: frames on the device, shown by their index."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import exposing
from deepfsi import evaluate, learn, load_design
from deepfsi.base.errors import InputError
from deepfsi.camera.device import find_device
from deepfsi.hardware.live import record as frame_log
from deepfsi.hardware.live.record import LiveCounts
from deepfsi.hardware.live.run import plan_live, run_live
from deepfsi.hardware.patterns.folder import (
    FrameSettings,
    export_patterns,
    read_frames,
    read_patterns,
)
from deepfsi.hardware.patterns.frames import unpack
from deepfsi.hardware.virtual.camera import CAMERAS, VirtualCamera
from deepfsi.hardware.virtual.setup import virtual_setup
from deepfsi.lab import adaptive_looks
from deepfsi.lab.setup import design_rails, open_looks
from shared.live_samples import replay, scenes_of

LOOKS, MASKS, FLUX, EXPOSURE_S, LOAD_S = 12, 300, 1e6, 10e-3, 2e-3
OFF = 1
DEVICE = find_device("64x48").model_copy(update={"load_us": round(LOAD_S * 1e6)})


@pytest.fixture(scope="module")
def design(digits):
    """Digits at 10⁴ photons."""
    settings = {"design": "adaptive", "masks": LOOKS, "photons": FLUX * EXPOSURE_S}
    return learn(digits, **settings, training={"dictionary": MASKS})


@pytest.fixture(scope="module")
def patterns(design, tmp_path_factory):
    folder = tmp_path_factory.mktemp("stored")
    design.save(folder / "a.safetensors")
    rails = design_rails(folder / "a.safetensors")
    export_patterns(rails, FrameSettings(DEVICE, 1e-3), folder / "patterns")
    return folder / "patterns"


def devices_of(patterns, data, count, camera=CAMERAS["ideal"], **settings):
    """Acquisition, virtual devices and looks of scenes."""
    (x, scenes), looks = scenes_of(data, count), open_looks(patterns)
    told = {"flux": FLUX, "camera": camera.model_dump(mode="json"), "seed": 0, **settings}
    acquisition = plan_live(patterns, scenes, EXPOSURE_S, looks=looks, **told)
    devices = virtual_setup(patterns, x, acquisition, decision_s=looks.decision_s)
    return acquisition, devices, looks


def run(folder, patterns, data, count, **settings):
    """Run scenes on the virtual bench; their decisions."""
    acquisition, devices, looks = devices_of(patterns, data, count, **settings)
    return list(run_live(folder, patterns, acquisition, devices, looks))


@pytest.fixture(scope="module")
def whole(digits, patterns, tmp_path_factory):
    """Folder of a run of 100 scenes, and its decisions."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    decided = run(folder, patterns, digits, 100)
    return folder, decided


def test_the_folder_holds_the_dictionary_once_mask_by_mask(design, patterns):
    """Frame p + 2 is the picture of mask p, each mirror of a cell ON or OFF with its pixel."""
    masks = design.prior_exposure.dictionary.masks.numpy().astype(bool)
    read = read_patterns(patterns)
    manifest = read.manifest
    assert [manifest.frames[at].mask for at in manifest.shown] == list(range(MASKS))
    grid = manifest.grid
    for frame, mask in zip(list(read_frames(patterns))[2:-2], masks, strict=True):
        cells = unpack(frame, DEVICE)[grid.window].reshape(8, grid.height, 8, grid.width)
        assert (cells == mask.reshape(8, 1, 8, 1)).all()
    np.testing.assert_array_equal(read.fractions, masks)


def test_frames_that_are_shown_are_the_exported_ones_bit_for_bit(
    digits, patterns, tmp_path, monkeypatch
):
    """Index p shows picture p of the folder, of the mask that the posterior asks for; no load."""
    acquisition, devices, looks = devices_of(patterns, digits, 2)
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
    list(run_live(tmp_path / "run", patterns, acquisition, devices, looks))
    pictures = list(read_frames(patterns))
    manifest = read_patterns(patterns).manifest
    asked = [frames for frames in shown if frames != [0, OFF, OFF]]
    for scene in frame_log.FrameLog.read(tmp_path / "run").scenes:
        looked = scene.lists[1:-1]
        assert len(looked) == LOOKS
        assert len({each.frames for each in looked}) > LOOKS / 2
        for logged in looked:
            [frame] = logged.frames
            assert logged.masks == ()
            assert asked.pop(0) == [frame, OFF]
            assert chosen.pop(0) == frame - 2
            mask = looks.stored.masks[frame - 2].bool().numpy()
            assert np.array_equal(pictures[frame], manifest.lit_frame(mask))
    assert not asked


def test_counts_are_those_of_the_exported_pictures(digits, patterns, whole):
    """Poisson, with the mean that the light through picture p has in its gate."""
    folder, _ = whole
    x, _ = scenes_of(digits, 100)
    read, z = read_patterns(patterns), []
    for shown, lists in LiveCounts.count(folder).by_scene:
        for each, counted in zip(shown.lists[1:-1], lists[1:-1], strict=True):
            lit = read.fractions[each.frames[0] - 2]
            light = lit @ x[shown.scene].ravel() * FLUX / read.manifest.summed_reflectance
            expected = light * each.gate_ns[0] * 1e-9
            if expected > 20:
                z.append((counted.counts[0, 0] - expected) / np.sqrt(expected))
    assert len(z) > 500
    assert abs(np.mean(z)) < 5 / np.sqrt(len(z))
    assert abs(np.mean(np.square(z)) - 1) < 5 * np.sqrt(2.1 / len(z))


def test_decisions_are_those_of_the_design_and_its_replay(digits, design, patterns, whole):
    """Accuracy within the noise of both; the replay answers the same."""
    folder, decided = whole
    last = [each.answer for each in decided if each.answer]
    right = np.mean([each.predicted == each.label for each in last if each.predicted])
    few = replace(digits, x_test=digits.x_test[:100], y_test=digits.y_test[:100])
    own = load_design(patterns.parent / "a.safetensors")
    [wanted] = evaluate(own, few, FLUX * EXPOSURE_S, draws=2)
    assert abs(right - wanted.accuracy) < 5 * np.sqrt(
        2 * wanted.accuracy * (1 - wanted.accuracy) / 100
    )
    counts = [
        sum(list_counts.counts.sum() for list_counts in lists[1:-1])
        for _, lists in LiveCounts.count(folder).by_scene
    ]
    # scenes are the same, masks follow from other counts
    assert np.mean(counts) == pytest.approx(wanted.counts, rel=0.05)
    assert [each.answer for each in replay(folder)] == last
    faults = [fault.kind for each in last for fault in each.faults]
    assert set(faults) <= {"unsure"}
    assert len(faults) <= 11  # 0.04 of 100 at most, at a chance of 1 in 1000


@pytest.mark.parametrize("load_s", [0.0, 1.0])
def test_the_clock_of_a_scene_has_no_loading(digits, patterns, tmp_path, load_s):
    """All frames are loaded before the first scene, however long that takes."""
    acquisition, devices, looks = devices_of(patterns, digits, 1)
    devices.projector._optics.latencies |= dict.fromkeys(("transfer", "command", "decision"), 0)
    devices.projector._optics.latencies |= {"load": load_s, "block": 1e-6}
    began = devices.clock()
    [answer] = [
        step.answer
        for step in run_live(tmp_path / "run", patterns, acquisition, devices, looks)
        if step.answer
    ]
    ends_s = 2 * 3 * 1e-3  # all ON and all OFF, before and after, in lists that end all OFF
    assert EXPOSURE_S < answer.clock_s < EXPOSURE_S + ends_s + LOOKS * 0.1e-3
    loaded = (MASKS + 4) * load_s
    assert loaded <= devices.clock() - began < loaded + 0.1


def test_devices_that_load_nothing_while_they_run_show_a_dictionary(patterns, tmp_path):
    rails = design_rails(patterns.parent / "a.safetensors")
    frames = FrameSettings(find_device("dlp6500"), 1e-3, format="planes")
    written = export_patterns(rails, frames, tmp_path / "other")
    lines = " ".join(map(str, written.lines()))
    assert "300 frames of masks and 4 all-ON" in lines
    assert "one of these masks by its index, so that nothing is loaded between looks" in lines
    assert "virtual devices alone show them: the driver of dlp6500" in lines
    assert "virtual devices alone" not in " ".join(map(str, read_patterns(patterns).lines()))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"patterns": 303},
            "304 frames do not fit 64x48, whose controller holds 303: learn the design with "
            "`dictionary` of 299 at most, or use a device that holds them, such as dlp7000",
        ),
        ({"video_us": 10000}, "shown by their index, and 64x48 shows the frames of a video"),
    ],
)
def test_devices_that_cannot_hold_or_reach_a_mask_are_refused(patterns, tmp_path, change, words):
    """In one line, with nothing written."""
    device = DEVICE.model_copy(update=change)
    rails = design_rails(patterns.parent / "a.safetensors")
    with pytest.raises(InputError, match=words) as refused:
        export_patterns(rails, FrameSettings(device, 1e-3), tmp_path / "other")
    assert "\n" not in str(refused.value)
    assert not list(tmp_path.iterdir())
    if "patterns" in change:  # one more is enough
        held = DEVICE.model_copy(update={"patterns": 304})
        export_patterns(rails, FrameSettings(held, 1e-3), tmp_path / "held")


def test_a_mask_without_light_is_not_of_a_dictionary(design, tmp_path):
    """It has no frame, and its counts tell nothing."""
    exposure = design.prior_exposure
    masks = exposure.dictionary.masks.clone()
    masks[3] = 0
    dark = replace(exposure.dictionary, masks=masks)
    exposing(design, dictionary=dark).save(tmp_path / "a.safetensors")
    with pytest.raises(InputError, match="mask without light in its dictionary"):
        design_rails(tmp_path / "a.safetensors")
    kept = type(dark).drawn(torch.cat([masks, 0 * masks]), 1000, torch.Generator())
    assert len(kept) == MASKS - 1


@pytest.mark.parametrize("other", [2 + MASKS, OFF])
def test_a_frame_that_is_no_mask_of_the_dictionary_is_found(digits, patterns, tmp_path, other):
    folder = tmp_path / "run"
    run(folder, patterns, digits, 1)
    path = folder / frame_log.FrameLog.NAME
    content = json.loads(path.read_text())
    content["lists"][1]["frames"] = [other]
    path.write_text(json.dumps(content) + "\n")
    with pytest.raises(InputError, match="does not fit the patterns"):
        replay(folder)


def test_tables_are_kept_while_the_light_stays(digits, patterns, tmp_path, monkeypatch):
    """Computed anew where budget or dark counts are others; each run begins with its own."""
    from deepfsi.adaptive import dictionary

    computed = []
    made = dictionary.MaskTables.of.__func__
    monkeypatch.setattr(
        dictionary.MaskTables,
        "of",
        classmethod(lambda cls, *given: (computed.append(given[2]), made(cls, *given))[1]),
    )
    acquisition, devices, looks = devices_of(patterns, digits, 20, photons=FLUX * EXPOSURE_S)
    list(run_live(tmp_path / "one", patterns, acquisition, devices, looks))
    assert len(computed) == 1
    state = looks.exposure.optics_at(1e4)
    assert looks.tabled(1, replace(state, photons=1.019e4)) is not state
    first = looks.tabled(0, state)
    assert first is state
    assert looks.tabled(1, replace(state, photons=1.019e4)) is state
    assert looks.tabled(2, replace(state, dark=3.0)) is state
    for other in (replace(state, photons=1.021e4), replace(state, dark=10.0)):
        looks.tabled(0, state)
        assert looks.tabled(3, other) is other
        assert looks.tabled(4, replace(other)) is other


def test_dark_counts_are_known(digits, patterns, tmp_path):
    camera = VirtualCamera(dark=FLUX / 4)
    noisy = run(tmp_path / "noisy", patterns, digits, 40, camera=camera)
    right = [each.answer.predicted == each.answer.label for each in noisy if each.answer]
    assert np.mean(right) > 0.7
