"""Laws of a live run on virtual devices, and of its log."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from deepfsi import InputError, classify_run
from deepfsi.counting.reader import count_windows, read_markers, summarise
from deepfsi.lab import results as frame_log
from deepfsi.lab import virtual_optics as camera_module
from deepfsi.lab.devices import LATENCIES, VirtualBench, virtual_setup
from deepfsi.lab.virtual_detector import DETECTOR_TICK_S
from deepfsi.lab.virtual_optics import VirtualCamera
from shared.live_samples import DEVICE, EXPOSURE_S, LOOKS, live, make_patterns, planned, scenes_of


@pytest.fixture(scope="module")
def patterns(digits, tmp_path_factory):
    return make_patterns(tmp_path_factory.mktemp("live"), digits)


@pytest.fixture(scope="module")
def run(digits, patterns, tmp_path_factory):
    """A run of twelve scenes; do not change it."""
    folder = tmp_path_factory.mktemp("run") / "run"
    live(folder, patterns, digits, count=12)
    return folder


@pytest.fixture
def copied(run, tmp_path):
    return shutil.copytree(run, tmp_path / "run")


def test_the_clock_adds_up(digits, patterns, tmp_path):
    """A scene takes its pictures and, for each list, command, block, transfer and decision."""
    slow = {"display": 0.5, "block": 0.1, "transfer": 0.003, "command": 0.01, "decision": 0.002}
    x, scenes = scenes_of(digits, 3)
    live_run = planned(patterns, scenes)
    devices = virtual_setup(live_run.patterns, x, live_run.settings)
    devices.projector.latencies |= slow
    decided = list(live_run.steps(tmp_path / "run", devices))
    times = {}
    for each in decided:
        times.setdefault(each.scene, []).append(each.clock_s)
    for scene in frame_log.read_log(tmp_path / "run"):
        assert scene.clock_s == times[scene.scene][-1]
        assert np.diff(times[scene.scene]).min() >= 0.01
        lists = 2 + LOOKS
        # Each list ends with a block of the counter: 0.1 s, as lists take less.
        assert 0.1 * (lists - 1) < scene.clock_s <= 0.1 * lists + 0.0051


def test_exposures_that_share_light_end_when_sure_and_take_the_cap_at_most(digits, tmp_path):
    """Of 3 looks each takes 2/3 of the exposure, which is the mean, less what the clock rounds."""
    patterns = make_patterns(tmp_path, digits, exposure={"cap": 2})
    decided = live(tmp_path / "run", patterns, digits, count=20)
    threshold = planned(patterns, scenes_of(digits, 1)[1]).settings.live.rule.threshold
    for each in decided:
        assert each.light_s == pytest.approx(2 / LOOKS * (each.look + 1) * EXPOSURE_S, 1e-3)
        ends = each.look == LOOKS - 1 or each.probabilities.max() > threshold
        assert each.final == ends
    assert len({each.look for each in decided if each.final}) > 1


@pytest.mark.parametrize("stop", [KeyboardInterrupt, InputError("the device refuses")])
def test_finished_scenes_are_kept_when_a_run_is_stopped(digits, patterns, tmp_path, stop):
    x, scenes = scenes_of(digits, 6)
    live_run = planned(patterns, scenes)
    devices = virtual_setup(live_run.patterns, x, live_run.settings)
    folder, done = tmp_path / "run", []
    whole = devices.projector.show

    def show(frames, dwells_s):
        if len(done) == 2 * LOOKS + 1:  # within the third scene
            raise stop
        whole(frames, dwells_s)

    devices.projector.show = show
    with pytest.raises(type(stop) if isinstance(stop, Exception) else stop):  # noqa: PT012
        for each in live_run.steps(folder, devices):
            done.append(each)
    found = classify_run(patterns, folder).scenes
    assert [each.predicted for each in found] == [
        each.answer.predicted for each in done[: 2 * LOOKS] if each.answer
    ]


def test_a_line_that_a_killed_run_left_is_no_scene(copied):
    path = copied / frame_log.LOG
    path.write_bytes(path.read_bytes()[:-20])
    assert len(frame_log.read_log(copied)) == 11


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda old: old[: old.index(b"\n") + 1].replace(b"[0.", b"[0.5,0."), "does not fit"),
        (lambda old: old[old.index(b"\n") + 1 :], "do not follow each other"),
        (lambda old: old.replace(b"chances", b"odds"), "is damaged"),
    ],
)
def test_a_log_that_was_changed_is_refused(patterns, copied, change, words):
    path = copied / frame_log.LOG
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(InputError, match=words):
        classify_run(patterns, copied)


def test_classes_that_were_given_before_a_refusal_say_so(patterns, copied):
    path = copied / frame_log.LOG
    lines = path.read_text().splitlines(keepends=True)
    given = classify_run(patterns, copied).scenes
    whole = '"faults":[{"kind":"view","detail":"mirrored"},'
    lines[4] = lines[4].replace('"faults":[', whole).replace("},]", "}]")
    path.write_text("".join(lines))
    found = classify_run(patterns, copied).scenes
    kinds = [{fault.kind for fault in each.faults} for each in found]
    assert ["early" in each for each in kinds] == 4 * [True] + 8 * [False]
    assert [each.predicted for each in found[:4]] == [each.predicted for each in given[:4]]
    assert found[4].predicted is None
    assert all("early" in each.cells()["remarks"] for each in found[:4])
    assert "before the run was refused, at scene 4" in found[0].as_dict()["faults"][-1]


def test_settings_that_cannot_be_are_refused(digits, patterns, tmp_path):
    with pytest.raises(InputError, match="between 0 and 1"):
        live(tmp_path / "run", patterns, digits, until=1.0)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"video_us": 8333}, "takes no frame then"),
        ({"longest_us": 3000}, "shows a mask for .* to 0.003 s"),
    ],
)
def test_devices_that_cannot_show_a_look_are_refused(digits, tmp_path, limits, words):
    device = DEVICE.model_copy(update=limits)
    with pytest.raises(InputError, match=words):
        live(tmp_path / "run", make_patterns(tmp_path, digits, device=device), digits)


def test_the_lines_of_the_page_run(digits, patterns, tmp_path, monkeypatch, capsys):
    """The program of the page, word for word, on a laboratory of two scenes."""
    page = (Path(__file__).parents[2] / "docs/do/live.md").read_text()
    [loop] = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
    monkeypatch.chdir(tmp_path)
    Path("adaptive").symlink_to(patterns)
    x, scenes = scenes_of(digits, 2)
    live_run = planned(patterns, scenes)
    devices = virtual_setup(live_run.patterns, x, live_run.settings)
    names = {f"my_{name}": getattr(devices, name) for name in ("projector", "counter", "display")}
    exec(loop, names)
    decided = capsys.readouterr().out.splitlines()
    assert len(decided) == 2


def test_long_gates_end_within_their_pictures_where_clocks_differ(digits, patterns, tmp_path):
    """A device whose clock is fast by 10⁻⁴ shortens a picture of 1 s by more than it settles."""
    x, scenes = scenes_of(digits, 2)
    live_run = planned(patterns, scenes, 3.0 * LOOKS, flux=1e4)
    devices = virtual_setup(live_run.patterns, x, live_run.settings)
    whole = devices.projector.show
    devices.projector.show = lambda frames, dwells_s: whole(frames, dwells_s * (1 - 1e-4))
    decided = list(live_run.steps(tmp_path / "run", devices))
    assert len(decided) == 2 * LOOKS
    shown = frame_log.read_log(tmp_path / "run")
    assert max(max(one.gate_ns) for each in shown for one in each.lists[1:-1]) > 0.2e9


def test_lists_follow_each_other_on_one_clock_and_every_photon_is_kept(tmp_path):
    """Frames of three rates, twice, between times that nothing is shown anew; stamps jitter.

    Every event of what was shown is in the file, to the end of the last frame, and none after it.
    """
    rates = np.array([[[0.0], [1e6], [3e6]]])
    camera, dwells = VirtualCamera(jitter_s=1e-7), np.array([2e-3, 1e-3, 4e-3])
    setup = VirtualBench(rates, camera, LATENCIES | {"command": 5e-3, "display": 50e-3}, (0,))
    path = tmp_path / "run.ptu"
    setup.start(path)
    starts = []
    for _ in range(2):
        setup.display(0)
        shown_s = setup.now_s + 5e-3
        setup.show(np.array([1, 2, 0]), dwells)
        starts.append(shown_s + np.array([0, *np.cumsum(dwells[:-1])]))
    setup.wait()
    assert setup.now_s == pytest.approx(
        starts[-1][0] + dwells.sum() + 8e-7, abs=2 * DETECTOR_TICK_S
    )
    setup.stop()
    times, bits = read_markers(path)
    assert (bits == camera_module.FRAME_MARKER).all()
    np.testing.assert_allclose(
        times * DETECTOR_TICK_S, np.concatenate(starts), atol=2 * DETECTOR_TICK_S
    )
    edges, shown = np.concatenate(starts), np.tile(dwells, 2)
    gates = (np.rint(each / DETECTOR_TICK_S).astype(np.int64) for each in (edges, edges + shown))
    found = count_windows(path, *gates)[:, 0]
    expected = np.tile(rates[0, [1, 2, 0], 0], 2) * shown
    # Some 0.3 counts come into a gate from beside it, or leave it
    assert (abs(found - expected) < 5 * np.sqrt(expected) + 5).all()
    waited = 1e6 * starts[0][0]  # frame 1 is seen until the first list
    whole = waited + expected.sum()
    assert abs(summarise(path).photons[1] - whole) < 5 * np.sqrt(whole)
