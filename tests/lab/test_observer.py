"""Laws of the decisions of a live run: what they owe to the budget, dead time and light."""

from dataclasses import replace

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.camera.dead_time import DeadTime
from deepfsi.counting.acquisition import Scene
from deepfsi.lab.observer import SceneObserver
from deepfsi.lab.virtual_detector import Detector
from deepfsi.patterns.folder import Patterns
from shared.live_samples import EXPOSURE_S, LOOKS, OPTICS, make_patterns, planned

FLUX = 1e7


@pytest.fixture(scope="module", params=OPTICS)
def patterns(request, digits, tmp_path_factory, all_trained_once):
    few = replace(digits, x_train=digits.x_train[:400], y_train=digits.y_train[:400])
    return make_patterns(tmp_path_factory.mktemp("decisions"), few, request.param)


def light(patterns, scene, lists):
    """Counts/s (f, inputs) of a scene (N,) behind the frames of a list, without any noise."""
    manifest = Patterns.read(patterns).manifest
    ends = np.stack([np.ones(scene.size), np.zeros(scene.size)])
    on = ends if lists.masks is None else lists.masks
    cells = np.array(manifest.detectors.cells if manifest.detectors else [0] * scene.size)
    sees = np.arange(manifest.detector_count)[:, None] == cells
    arms = np.stack([on, 1 - on][: manifest.arms], axis=1)[:, :, None]
    return (
        (arms * sees * scene).sum(axis=-1).reshape(len(on), -1)
        * FLUX
        / (manifest.summed_reflectance)
    )


def observe(patterns, scenes, change=lambda rates, lists: rates, labels=(), **settings):
    """Decisions on scenes (n, N) whose counts are their means, and the lists asked for."""
    labels = dict(enumerate(labels))
    named = tuple(Scene(name=str(k), label=labels.get(k)) for k in range(len(scenes)))
    run, asked = planned(patterns, named, **settings), []
    observer = SceneObserver(run.design, run.patterns.manifest, run.settings)

    def source(number, scene):
        def counts(lists):
            asked.append(lists)
            return change(light(patterns, scene, lists), lists) * lists.gate_ns[:, None] * 1e-9

        return counts

    decided = [list(observer.observe(k, source(k, scene))) for k, scene in enumerate(scenes)]
    return decided, asked


def check_alike(decided, again):
    """The same answers at the same budget."""
    for one, other in zip(decided, again, strict=True):
        np.testing.assert_allclose(other.probabilities, one.probabilities, atol=1e-4)
        assert other.photons == pytest.approx(one.photons, rel=1e-6)


@pytest.mark.parametrize("paralysable", [False, True])
def test_dead_time_changes_no_decision_where_it_is_known(digits, patterns, paralysable):
    """A counter that is blind for a fifth of the time at all ON, with the law that it keeps."""
    scenes, dead = digits.x_test[:1], DeadTime(seconds=25e-9, paralysable=paralysable)
    detector = Detector(dead_time_s=dead.seconds, paralysable=paralysable)
    (clean,), _ = observe(patterns, scenes)

    def registered(rates, lists):
        return detector.registered(rates)

    (corrected,), _ = observe(patterns, scenes, registered, dead_time=dead)
    (blind,), _ = observe(patterns, scenes, registered)
    check_alike(clean, corrected)
    assert blind[-1].photons < 0.96 * clean[-1].photons


def test_a_scene_is_judged_by_the_light_of_all_so_far(digits, patterns):
    scenes = digits.x_test[:3]
    decided, asked = observe(patterns, scenes)
    flux = scenes.sum(axis=1) * FLUX / Patterns.read(patterns).manifest.summed_reflectance
    for k, each in enumerate(decided, start=1):
        frames = np.full(k, 2.0)
        frames[-1] = 1  # the second all-ON frame of this scene follows its looks
        mean = flux[:k] @ frames / frames.sum()
        assert each[-1].photons == pytest.approx(mean * EXPOSURE_S, rel=1e-6)
    ends = asked[0].look
    assert [each.look for each in asked] == 3 * [ends, *range(LOOKS), ends]


@pytest.mark.parametrize("paralysable", [False, True])
def test_an_all_on_frame_too_bright_for_its_dead_time_ends_the_run(digits, patterns, paralysable):
    dead = DeadTime(seconds=1e-6, paralysable=paralysable)
    scenes, most = digits.x_test[:1], []

    def scaled(share):
        def change(rates, lists):
            most.append(rates.max())  # that of an all-ON frame comes first
            return rates * share * dead.most_registered / most[0]

        return change

    with pytest.raises(InputError, match="corrected up to"):
        observe(patterns, scenes, scaled(1.01), dead_time=dead)
    observe(patterns, scenes, scaled(0.98), dead_time=dead)


def test_a_scene_without_light_is_not_decided_upon_and_changes_no_budget(digits, patterns):
    scenes = digits.x_test[:4].copy()
    scenes[:2] = 0
    decided, _ = observe(patterns, scenes, lambda rates, lists: rates + 1e5)
    assert [len(each) for each in decided] == [1, 1, LOOKS, LOOKS]
    (alone, *_), _ = observe(patterns, scenes[2:], lambda rates, lists: rates + 1e5)
    assert decided[2][-1].photons == pytest.approx(alone[-1].photons, rel=1e-6)


@pytest.mark.parametrize("paralysable", [False, True])
def test_a_mask_beyond_the_rate_that_is_sure_is_corrected_as_there(digits, patterns, paralysable):
    """A short gate may be, by chance: its photons stay finite and above 0, and the run goes on."""
    dead = DeadTime(seconds=25e-9, paralysable=paralysable)

    def too_bright(rates, lists):
        return np.full_like(rates, 2.5 * dead.most_registered) if lists.look == 1 else rates

    def arrived(rates, lists):
        counted = too_bright(rates, lists)
        factor = dead.correction(np.minimum(counted, dead.most_registered)).arrivals
        return counted * factor

    scenes = digits.x_test[:1]
    (found,), _ = observe(patterns, scenes, too_bright, dead_time=dead)
    (clean,), _ = observe(patterns, scenes, arrived)
    assert len(found) == len(clean) == LOOKS
    check_alike(found, clean)


@pytest.mark.parametrize("shown_before", ["black", "a scene"])
def test_a_display_that_lags_is_told_by_a_scene_that_is_to_be_dark(digits, patterns, shown_before):
    """Black is not without light: a display's is a thousandth, of which counts know."""
    planned_ones = np.concatenate([1e-3 * digits.x_test[:1], digits.x_test[:3]])
    sound, _ = observe(patterns, planned_ones, labels=["dark"])
    kinds = [{fault.kind for fault in each[-1].faults} for each in sound]
    assert kinds[0] == {"dark"}
    assert not any("late" in each for each in kinds)
    assert all(len(each) == LOOKS for each in sound[1:])
    before = planned_ones[:1] if shown_before == "black" else digits.x_test[4:5]
    lagging, _ = observe(patterns, np.concatenate([before, planned_ones[:-1]]), labels=["dark"])
    kinds = [{fault.kind for fault in each[-1].faults} for each in lagging]
    assert all("late" in each for each in kinds[2:])
    assert all({"late", "dark"} & each for each in kinds[:2]), "no class of another scene"
    unlabelled, _ = observe(patterns, np.concatenate([before, planned_ones[:-1]]))
    assert not any(fault.kind == "late" for each in unlabelled for fault in each[-1].faults)
