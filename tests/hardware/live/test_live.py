"""Laws of a live run on virtual devices, and of its replay."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.hardware.calibration import reference
from deepfsi.hardware.counting.acquisition import Scene
from deepfsi.hardware.live import record as frame_log
from deepfsi.hardware.live import run as runs
from deepfsi.hardware.live.run import run_live
from deepfsi.hardware.patterns.folder import read_patterns
from deepfsi.hardware.virtual.camera import VirtualCamera
from deepfsi.hardware.virtual.setup import virtual_setup
from deepfsi.lab.setup import check_view, open_looks
from shared.live_samples import (
    DEVICE,
    EXPOSURE_S,
    LOOKS,
    check_replay,
    live,
    make_patterns,
    planned,
    replay,
    scenes_of,
)


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
    slow = {"display": 0.5, "block": 0.1, "transfer": 0.003}
    x, scenes = scenes_of(digits, 3)
    acquisition, looks = planned(patterns, scenes)
    devices = virtual_setup(patterns, x, acquisition, latency_s=0.01, decision_s=0.002)
    devices.projector._optics.latencies |= slow
    decided = list(runs.run_live(tmp_path / "run", patterns, acquisition, devices, looks))
    times = {}
    for each in decided:
        times.setdefault(each.scene, []).append(each.clock_s)
    for scene in frame_log.FrameLog.read(tmp_path / "run").scenes:
        assert scene.clock_s == times[scene.scene][-1]
        assert np.diff(times[scene.scene]).min() >= 0.01
        lists = 2 + LOOKS
        # Each list ends with a block of the counter: 0.1 s, as lists take less.
        assert 0.1 * (lists - 1) < scene.clock_s <= 0.1 * lists + 0.0051


def test_exposures_that_share_light_end_when_sure_and_take_the_cap_at_most(digits, tmp_path):
    """Of 3 looks each takes 2/3 of the exposure, which is the mean, less what the clock rounds."""
    patterns = make_patterns(tmp_path, digits, exposure={"cap": 2})
    decided = live(tmp_path / "run", patterns, digits, count=20)
    threshold = open_looks(patterns).rule.threshold
    for each in decided:
        decision = each.decision
        assert decision.light_s == pytest.approx(2 / LOOKS * (decision.look + 1) * EXPOSURE_S, 1e-3)
        ends = decision.look == LOOKS - 1 or decision.chances.max() > threshold
        assert decision.final == ends
    assert len({each.decision.look for each in decided if each.decision.final}) > 1
    check_replay(tmp_path / "run", decided)


@pytest.mark.parametrize("stop", [KeyboardInterrupt, InputError("the device refuses")])
def test_finished_scenes_are_kept_when_a_run_is_stopped(digits, patterns, tmp_path, stop):
    x, scenes = scenes_of(digits, 6)
    acquisition, looks = planned(patterns, scenes)
    devices = virtual_setup(patterns, x, acquisition)
    folder, done = tmp_path / "run", []
    whole = devices.projector.show

    def show(frames, dwells_s):
        if len(done) == 2 * LOOKS + 1:  # within the third scene
            raise stop
        whole(frames, dwells_s)

    devices.projector.show = show
    with pytest.raises(type(stop) if isinstance(stop, Exception) else stop):  # noqa: PT012
        for each in runs.run_live(folder, patterns, acquisition, devices, looks):
            done.append(each)
    assert len(frame_log.FrameLog.read(folder).scenes) == 2
    check_replay(folder, done[: 2 * LOOKS])


def test_a_line_that_a_killed_run_left_is_no_scene(copied):
    path = copied / frame_log.FrameLog.NAME
    path.write_bytes(path.read_bytes()[:-20])
    assert len(frame_log.FrameLog.read(copied).scenes) == 11
    assert len(replay(copied)) == 11


SHOWN = frame_log.FrameLog.NAME


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        (SHOWN, lambda old: old.replace(b'"look":0', b'"look":1'), "does not fit"),
        (SHOWN, lambda old: old.replace(b'"masks":["', b'"masks":["AAAA'), "are not of 64 pixels"),
        (SHOWN, lambda old: old[old.index(b"\n") + 1 :], "do not follow each other"),
        ("photons.ptu", lambda old: old[: len(old) // 2], "markers|lack records"),
    ],
)
def test_files_that_were_changed_are_refused(copied, file, change, words):
    path = copied / file
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(InputError, match=words):
        replay(copied)


def test_classes_are_those_of_the_masks_that_were_shown(copied):
    """And not of masks that this processor would have made."""
    first = replay(copied)[0].decisions[-1].chances
    path = copied / SHOWN
    lines = path.read_text().splitlines()
    scene = json.loads(lines[0])
    looks = scene["lists"][1:-1]
    looks[0]["masks"], looks[1]["masks"] = looks[1]["masks"], looks[0]["masks"]
    path.write_text("\n".join([json.dumps(scene), *lines[1:], ""]))
    assert not np.allclose(replay(copied)[0].decisions[-1].chances, first)


def test_settings_that_cannot_be_are_refused(digits, patterns, tmp_path):
    with pytest.raises(InputError, match="between 0 and 1"):
        live(tmp_path / "run", patterns, digits, until=1.0)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("limits", "words"),
    [({"video_us": 8333}, "for one time"), ({"longest_us": 3000}, "for 3000 at most")],
)
def test_devices_that_cannot_show_a_look_are_refused(digits, tmp_path, limits, words):
    device = DEVICE.model_copy(update=limits)
    patterns = make_patterns(tmp_path, digits, device=device)
    with pytest.raises(InputError, match=words):
        live(tmp_path / "run", patterns, digits)


def test_the_lines_of_the_page_run(digits, patterns, tmp_path, monkeypatch, capsys):
    """Both programs of the pages, word for word, on a laboratory of two scenes."""
    docs = Path(__file__).parents[3] / "docs"
    pages = [(docs / name).read_text() for name in ("do/live.md", "develop/drivers.md")]
    loop, *_, groups = re.findall(r"^```python\n(.*?)^```", "\n".join(pages), re.M | re.S)
    monkeypatch.chdir(tmp_path)
    Path("adaptive").symlink_to(patterns)
    x, scenes = scenes_of(digits, 2)
    acquisition, _ = planned(patterns, scenes)
    devices = virtual_setup(patterns, x, acquisition)
    names = {f"my_{name}": getattr(devices, name) for name in ("projector", "counter", "display")}
    exec(loop, names)
    decided = capsys.readouterr().out.splitlines()
    assert len(decided) == 2

    devices = virtual_setup(patterns, x, acquisition)
    devices.projector.load(patterns)
    shown = []

    manifest = read_patterns(patterns).manifest

    def my_recording(frames, gate_ns, masks):
        path = Path(f"{len(shown)}.ptu")
        shown.append(path)
        with devices.counter as counter:
            counter.start(path)
            for frame, mask in zip(frames, [] if masks is None else masks, strict=False):
                devices.projector.replace(int(frame), manifest.lit_frame(mask))
            settle = names["acquisition"].settle_s
            pictures = np.maximum(np.ceil(gate_ns * 1e-3 + settle * 1e6 + 2), 44) * 1e-6
            devices.projector.show(np.append(frames, 1), np.append(pictures, 44e-6))
        return path

    exec(groups, names | {"my_recording": my_recording, "my_display": devices.display, "np": np})
    said = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [(int(line[0]), int(line[1])) for line in said] == [
        (scene, look) for scene in range(2) for look in range(LOOKS)
    ]
    assert len(shown) == 2 * (2 + LOOKS)


def test_long_gates_end_within_their_pictures_where_clocks_differ(digits, patterns, tmp_path):
    """A device whose clock is fast by 10⁻⁴ shortens a picture of 1 s by more than it settles."""
    x, scenes = scenes_of(digits, 2)
    acquisition, looks = planned(patterns, scenes, 3.0 * LOOKS, flux=1e4)
    devices = virtual_setup(patterns, x, acquisition)
    whole = devices.projector.show
    devices.projector.show = lambda frames, dwells_s: whole(frames, dwells_s * (1 - 1e-4))
    decided = list(runs.run_live(tmp_path / "run", patterns, acquisition, devices, looks))
    assert len(decided) == 2 * LOOKS
    shown = frame_log.FrameLog.read(tmp_path / "run").scenes
    assert max(max(one.gate_ns) for each in shown for one in each.lists[1:-1]) > 0.2e9


def test_the_reference_of_a_live_run_tells_how_scenes_lie(digits, tmp_path):
    """Frames differ from scene to scene."""
    patterns = make_patterns(tmp_path, digits, masks=16)
    target = np.repeat(reference.TARGET[None], 2, axis=0)
    camera = VirtualCamera(view=((-1, 0, 1), (0, -1, 1), (0, 0, 1)))
    scenes = tuple(Scene(name=str(k)) for k in range(2))
    acquisition, looks = planned(patterns, scenes, 0.1, flux=5e6, camera=camera)
    devices = virtual_setup(patterns, target, acquisition)
    list(run_live(tmp_path / "run", patterns, acquisition, devices, looks))
    place = check_view(tmp_path / "run")
    assert place.layout.rotate == 180
    assert not place.fits
