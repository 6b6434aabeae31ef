"""Live runs in which something is wrong: what is noticed, and that such scenes get no class."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT
from deepfsi.lab.devices import VirtualBench, virtual_setup
from deepfsi.lab.virtual_detector import DETECTOR_TICK_S
from deepfsi.lab.virtual_optics import CAMERAS, EventRecorder, VirtualCamera
from shared.live_samples import EXPOSURE_S, make_patterns, planned, scenes_of

FLUX, SCENES = 1e7, 16
PHOTONS = FLUX * EXPOSURE_S


@pytest.fixture(scope="module")
def patterns(digits, tmp_path_factory):
    return make_patterns(tmp_path_factory.mktemp("trust"), digits, masks=8, photons=PHOTONS)


@dataclass(frozen=True)
class Lab:
    """A virtual laboratory in which something may be wrong."""

    camera: VirtualCamera = CAMERAS["ideal"]
    lamp: tuple[float, ...] = (1.0,) * SCENES  # light in each scene over the usual one
    outs_s: tuple[tuple[float, float], ...] = ()  # times without light
    flicker: tuple[float, float] = (0.0, 0.0)  # amplitude, and Hz


class Wavering(EventRecorder):
    """Light that goes out at times, or rises and falls."""

    lab = Lab()

    def see(self, durations, rates, report=SILENT):
        ends = self.end + np.cumsum(durations)
        outs = np.rint(np.array(self.lab.outs_s).ravel() / DETECTOR_TICK_S).astype(np.int64)
        size, hertz = self.lab.flicker
        every = outs
        if size:
            each = round(0.1 / hertz / DETECTOR_TICK_S)
            every = np.arange(self.end // each + 1, ends[-1] // each + 1) * each
        here = every[(every > self.end) & (every < ends[-1])]
        for end in np.unique(np.concatenate([ends, here])).tolist():
            wave = 1 + size * np.sin(2 * np.pi * hertz * (self.end + end) / 2 * DETECTOR_TICK_S)
            out = np.searchsorted(outs, end - 1, side="right") % 2
            seen = rates[[int(np.searchsorted(ends, end))]] * wave * (1 - out)
            super().see(np.array([end - self.end]), seen)


def answers(folder, patterns, digits, lab=Lab(), scenes=SCENES, change=None):
    """Answers of a run."""
    x, named = scenes_of(digits, scenes)
    run = planned(patterns, named, flux=FLUX, camera=lab.camera, seed=3)
    devices = virtual_setup(run.patterns, x, run.settings)
    setup = devices.projector
    setup.recorder.__class__, setup.recorder.lab = Wavering, lab
    lamp, rates_of = np.array(lab.lamp)[:scenes], setup._rates_of
    setup._rates *= lamp[:, None, None]
    setup._rates_of = lambda scene, packed: lamp[scene] * rates_of(scene, packed)
    if change:
        devices = replace(devices, display=change(setup) or setup.display)
    steps = run.steps(folder, devices)
    return [step.answer for step in steps if step.answer]


def kinds(answer):
    return {fault.kind for fault in answer.faults}


def test_a_sound_run_has_no_fault_but_the_stated_rate_of_unlike_scenes(digits, patterns, tmp_path):
    found = answers(tmp_path / "run", patterns, digits, scenes=40, lab=Lab(lamp=(1.0,) * 40))
    unlike = [each for each in found if each.faults]
    assert all(kinds(each) == {"unlike"} for each in unlike)
    assert len(unlike) <= 3  # at 1 in 100, a chance of 1 in 1000
    for each in found:
        assert (
            (each.predicted is None)
            == (each in unlike)
            == each.unlike
            == (each.probability is None)
        )


@pytest.mark.parametrize(
    ("lab", "said", "most"),
    [
        # a dead time that is not told
        (Lab(VirtualCamera(dead_time_s=50e-9)), "`dead_time`", 2),
        (Lab(flicker=(0.4, 100.0)), "flicker", 8),
    ],
)
def test_what_is_wrong_in_all_scenes_is_named_and_few_get_a_class(
    digits, patterns, tmp_path, lab, said, most
):
    found = answers(tmp_path / "run", patterns, digits, lab)
    assert sum(each.predicted is not None for each in found) <= most
    assert all(each.predicted is None for each in found[8:])
    assert said in " ".join(map(str, found[-1].faults))


@pytest.mark.parametrize("light", [0.2, 2.0])
def test_a_lamp_that_steps_starts_a_new_budget_and_is_said(digits, patterns, tmp_path, light):
    half = SCENES // 2
    lab = Lab(lamp=(1.0,) * half + (light,) * half)
    found = answers(tmp_path / "run", patterns, digits, lab)
    place, level = next(
        (place, fault)
        for place, each in enumerate(found)
        for fault in each.faults
        if fault.kind == "level"
    )
    assert half <= level.scene <= place < half + 4
    assert found[-1].photons == pytest.approx(light * found[half - 1].photons, rel=0.3)
    assert found[-1].predicted is not None


def test_a_scene_in_which_the_light_goes_out_gets_no_class(digits, patterns, tmp_path):
    """At five moments of the run, each within the looks of a scene."""
    starts = []
    whole = VirtualBench.display

    def watch(setup):
        return lambda scene: (whole(setup, scene), starts.append(setup.now_s))

    answers(tmp_path / "sound", patterns, digits, change=watch)
    struck = range(2, 12, 2)
    outs = tuple((starts[k] + 4e-3, starts[k] + 8e-3) for k in struck)
    found = answers(tmp_path / "run", patterns, digits, Lab(outs_s=outs))
    for place in struck:
        assert found[place].predicted is None, found[place]
        assert kinds(found[place]) & {"unsteady", "brighter", "flicker", "unlike"}


def test_a_trigger_that_jitters_is_named(digits, patterns, tmp_path):
    rng = np.random.default_rng(0)

    def jitter(setup):
        add = setup.recorder.add

        def late(times, code):
            off = rng.normal(0, 4e-6 / DETECTOR_TICK_S, len(times)).astype(np.int64)
            add(np.sort(times + off * (code < 0)), code)

        setup.recorder.add = late

    with pytest.raises(InputError, match="a trigger that jitters"):
        answers(tmp_path / "run", patterns, digits, change=jitter)
