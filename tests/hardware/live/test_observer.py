"""Laws of the decisions of a live run: what they owe to dark counts, the budget and the dwells."""

from types import SimpleNamespace

import numpy as np
import pytest

from deepfsi import Design
from deepfsi.base.errors import InputError
from deepfsi.camera.dead_time import CounterEffects, DeadTime
from deepfsi.hardware.counting.acquisition import Scene
from deepfsi.hardware.counting.streaming import FrameCounts
from deepfsi.hardware.light.curves import PARTS_OF_FRAME
from deepfsi.hardware.live import looks, run
from deepfsi.hardware.live.observer import SceneObserver
from deepfsi.hardware.patterns.folder import read_patterns
from deepfsi.hardware.virtual.camera import CAMERAS, arrival_rates
from deepfsi.hardware.virtual.detector import Detector
from deepfsi.lab.looks import open_looks
from shared.live_samples import LOOKS, OPTICS, make_patterns, scenes_of

EXPOSURE_S, FLUX = 10e-3, 1e7


@pytest.fixture(scope="module", params=OPTICS)
def patterns(request, digits, tmp_path_factory):
    return make_patterns(tmp_path_factory.mktemp("decisions"), digits, request.param)


def observe(patterns, rates, scenes=1, background=None, **settings):
    """Decisions on scenes whose counts are their means, and the lists that were asked for."""
    acquisition = run.plan_live(patterns, (Scene(name="a"),), EXPOSURE_S, **settings)
    manifest = read_patterns(patterns).manifest
    observer, asked = SceneObserver(open_looks(patterns), manifest, acquisition), []
    rates = rates if background is None else np.concatenate([rates, background[None]])

    def source(scene):
        def counts(lists):
            asked.append(lists)
            photons = rates[scene][lists.frames] * lists.gate_ns[:, None] * 1e-9
            starts_s = 0.1 * scene + 5e-3 * len(asked) + np.arange(len(photons)) * 1e-3
            return FrameCounts(
                starts_s, np.repeat(photons[:, None] / PARTS_OF_FRAME, PARTS_OF_FRAME, axis=1)
            )

        return SimpleNamespace(count=counts)

    if background is not None:
        observer.measure_background(source(-1))
        asked.clear()
    decided = [list(observer.observe(scene, source(scene))) for scene in range(scenes)]
    return decided, asked


def rates_of(patterns, digits, count=1, share=1.0):
    x, _ = scenes_of(digits, count)
    return share * arrival_rates(patterns, x, CAMERAS["ideal"], FLUX)


def check_alike(decided, again, share=1.0):
    """The same answers, of such a share of the budget."""
    for one, other in zip(decided, again, strict=True):
        np.testing.assert_allclose(other.chances, one.chances, atol=1e-4)
        assert other.photons == pytest.approx(one.photons * share, rel=1e-6)


def check_frames(asked, again):
    """The same frames, for times that are the same but for what they are measured by."""
    for one, other in zip(asked, again, strict=True):
        assert np.array_equal(one.frames, other.frames)
        np.testing.assert_allclose(one.gate_ns, other.gate_ns, rtol=1e-3)


def test_dark_counts_change_no_decision(digits, patterns):
    """Those of each input, which the all-OFF frames tell, or the all-ON ones of the second arm."""
    rates = rates_of(patterns, digits)
    dark = FLUX * np.linspace(0.2, 0.4, rates.shape[2])
    (clean,), asked = observe(patterns, rates)
    (noisy,), again = observe(patterns, rates + dark)
    assert len(clean) == len(noisy) == LOOKS
    check_alike(clean, noisy)
    check_frames(asked, again)


def test_ambient_light_changes_no_decision_where_it_was_measured(digits, patterns):
    """As strong as the scene's own, and of its own pattern over the device."""
    rates = rates_of(patterns, digits)
    uneven = np.linspace(0.5, 1.5, digits.pixels).reshape(1, *digits.image_shape)
    stray = arrival_rates(patterns, uneven, CAMERAS["ideal"], FLUX)[0]
    stray *= rates[0, 0].sum() / stray[0].sum()
    stray += FLUX * np.linspace(0.2, 0.4, rates.shape[2])  # dark counts
    (clean,), asked = observe(patterns, rates)
    (measured,), again = observe(patterns, rates + stray, background=stray)
    (fooled,), _ = observe(patterns, rates + stray)
    check_alike(clean, measured)
    check_frames(asked, again)
    assert fooled[-1].photons == pytest.approx(2 * clean[-1].photons, rel=1e-3)
    assert abs(fooled[-1].chances - clean[-1].chances).max() > 0.01


@pytest.mark.parametrize("paralysable", [False, True])
def test_dead_time_changes_no_decision_where_it_is_known(digits, patterns, paralysable):
    """A counter that is blind for a fifth of the time at all ON, with the law that it keeps."""
    rates, dead = rates_of(patterns, digits), DeadTime(seconds=25e-9, paralysable=paralysable)
    detector = Detector(dead_time_s=dead.seconds, paralysable=paralysable)
    (clean,), _ = observe(patterns, rates)
    (corrected,), _ = observe(
        patterns, detector.registered(rates), effects=CounterEffects(dead_time=dead)
    )
    (blind,), _ = observe(patterns, detector.registered(rates))
    check_alike(clean, corrected)
    assert blind[-1].photons < 0.96 * clean[-1].photons


def test_light_changes_no_decision(digits, patterns):
    """Features are counts over the budget, which is a flux in counts: of half the light, half."""
    (bright,), _ = observe(patterns, rates_of(patterns, digits))
    (dim,), _ = observe(patterns, rates_of(patterns, digits, share=0.5))
    check_alike(bright, dim, share=0.5)


def test_a_scene_is_judged_by_the_light_of_all_so_far(digits, patterns):
    rates = rates_of(patterns, digits, 3)
    (first, second, third), asked = observe(patterns, rates, 3)
    arm = read_patterns(patterns).manifest.detector_count
    flux = (rates[:, 0, :arm] - rates[:, 1, :arm]).sum(axis=1)
    for k, each in enumerate((first, second, third), start=1):
        frames = np.full(k, 2.0)
        frames[-1] = 1  # the second all-ON frame of this scene follows its looks
        mean = flux[:k] @ frames / frames.sum()
        assert each[-1].photons == pytest.approx(mean * EXPOSURE_S, rel=1e-6)
    ends = asked[0].look
    assert [each.look for each in asked] == 3 * [ends, *range(LOOKS), ends]


@pytest.mark.parametrize("paralysable", [False, True])
def test_an_all_on_frame_too_bright_for_its_dead_time_ends_the_run(digits, patterns, paralysable):
    dead = DeadTime(seconds=1e-6, paralysable=paralysable)
    rates = rates_of(patterns, digits)
    rates *= 1.01 * dead.most_registered / rates.max()
    with pytest.raises(InputError, match="corrected up to"):
        observe(patterns, rates, effects=CounterEffects(dead_time=dead))
    observe(patterns, 0.98 * rates, effects=CounterEffects(dead_time=dead))


def test_a_design_s_own_shortest_dwell_is_kept(digits, tmp_path):
    patterns = make_patterns(tmp_path, digits, shortest_dwell=0.1, epochs=1)
    _, asked = observe(patterns, rates_of(patterns, digits))
    gates = np.concatenate([each.gate_ns for each in asked if each.look >= 0])
    acquisition = run.plan_live(patterns, scenes_of(digits, 1)[1], EXPOSURE_S)
    assert acquisition.live.shortest_ns == round(0.1 * EXPOSURE_S * 1e9)
    assert gates.min() >= 0.1 * EXPOSURE_S * 1e9 * (1 - 1e-5)


def test_every_optics_is_decided_upon_as_by_the_design(digits, patterns):
    """`Design.classify_live`, given the counts that each rail of each mask should have."""
    design = Design.load(patterns.parent / "looks.safetensors")
    manifest = read_patterns(patterns).manifest
    rates = rates_of(patterns, digits)
    (decided,), (_, *asked, _) = observe(patterns, rates)
    shown = iter(asked)

    def read(dwell):
        each, share = next(shown), np.zeros_like(dwell)
        rails = np.zeros((2, design.masks, design.detection.count))
        for place, gate_ns in zip(each.frames, each.gate_ns, strict=True):
            frame = manifest.frames[place]
            arms = np.split(rates[0, place] * gate_ns * 1e-9, 2 if frame.rail == "both" else 1)
            for arm, counts in enumerate(arms, int(frame.rail == "minus")):
                rails[arm, frame.mask] = counts
            share[(int(frame.rail == "minus"), frame.mask)[2 - dwell.ndim :]] = gate_ns * 1e-9
        counts = rails if design.rails.count == 2 else rails[0]
        return counts.reshape(design.counts_shape), share / EXPOSURE_S

    chances = design.classify_live(read, decided[-1].photons)
    np.testing.assert_allclose(chances, decided[-1].chances, atol=1e-4)


@pytest.mark.parametrize("dead_s", [0.0, 25e-9])
def test_law_all_on_frames_have_the_noise_of_what_is_subtracted_and_of_a_dead_time(
    digits, patterns, monkeypatch, dead_s
):
    """Of n arrivals a second a non-paralysable counter gives the variance n (1 + nτ)."""
    rates, dead, seen = rates_of(patterns, digits), DeadTime(seconds=dead_s), []
    dark = FLUX * np.linspace(0.2, 0.4, rates.shape[2])
    arrived = rates + dark
    exposure, usual = looks.FixedMaskExposure, looks.FixedMaskExposure.compare
    monkeypatch.setattr(exposure, "compare", lambda self, on: seen.append(on) or usual(self, on))
    effects = CounterEffects(dead_time=dead)
    _, asked = observe(patterns, arrived / (1 + arrived * dead_s), effects=effects)
    [on], arm = seen, slice(0, read_patterns(patterns).manifest.detector_count)
    seconds = sum(each.gate_ns[0] for each in (asked[0], asked[-1])) * 1e-9
    assert on.seconds == pytest.approx(seconds)
    assert on.counts == pytest.approx(rates[0, 0, arm].sum() * seconds, rel=1e-6)
    lost = (arrived[0, 0] ** 2 * dead_s)[arm].sum() * seconds
    assert on.noise == pytest.approx(dark[arm].sum() * seconds + lost, rel=1e-6)


def test_a_scene_without_light_is_not_decided_upon_and_changes_no_budget(digits, patterns):
    rates = rates_of(patterns, digits, 4) + 1e5
    rates[:2] = 1e5
    decided, _ = observe(patterns, rates, 4)
    assert [len(each) for each in decided] == [0, 0, LOOKS, LOOKS]
    (alone, *_), _ = observe(patterns, rates[2:], 2)
    assert decided[2][-1].photons == pytest.approx(alone[-1].photons, rel=1e-6)


@pytest.mark.parametrize("paralysable", [False, True])
def test_a_mask_beyond_the_rate_that_is_sure_is_corrected_as_there(digits, patterns, paralysable):
    """A short gate may be, by chance: its photons stay finite and above 0, and the run goes on."""
    dead = DeadTime(seconds=25e-9, paralysable=paralysable)
    rates, shown = rates_of(patterns, digits), read_patterns(patterns).manifest.shown
    rates[:, shown[::2]] = 2.5 * dead.most_registered
    (found,), asked = observe(patterns, rates, effects=CounterEffects(dead_time=dead))
    rates *= dead.correction(np.minimum(rates, dead.most_registered)).arrivals
    (arrived,), again = observe(patterns, rates)
    assert len(found) == len(arrived) == LOOKS
    check_alike(found, arrived)
    check_frames(asked, again)


def test_the_light_of_a_decision_is_that_of_all_looks_so_far(digits, patterns):
    rates = rates_of(patterns, digits, 2)
    decided, asked = observe(patterns, rates, 2)
    light = np.array([each.gate_ns.sum() for each in asked if each.look >= 0])
    for scene, own in zip(decided, light.reshape(2, LOOKS), strict=True):
        assert [each.light_s for each in scene] == pytest.approx(np.cumsum(own) * 1e-9)
