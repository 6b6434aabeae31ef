"""Virtual projector and counter: a scan records what the camera sees."""

import numpy as np
import pytest
from virtual_samples import SHAPE, patterns

from deepfsi.errors import InputError
from deepfsi.hardware.drivers.protocols import PatternProjector, PhotonCounter, scan
from deepfsi.hardware.ptu.header import read_header
from deepfsi.hardware.ptu.reader import count_gates, read_markers
from deepfsi.hardware.virtual.camera import Camera, arrival_rates, write_photons
from deepfsi.hardware.virtual.devices import VirtualCounter, VirtualProjector


class Display:
    """What is shown now."""

    def __init__(self):
        self.scene = None

    def show(self, scene):
        self.scene = scene


def virtual_run(folder, scenes, path):
    camera, flux = Camera(dark=2e3), 1e6
    display = Display()
    projector: PatternProjector = VirtualProjector(lambda: display.scene)
    with projector:
        projector.load(folder)
        counter: PhotonCounter = VirtualCounter(projector, camera, flux, seed=0)
        with counter:
            scan(projector, counter, scenes, display.show, path)
    return arrival_rates(folder, np.stack(scenes), camera, flux)


def test_a_scan_records_each_scene_as_the_camera_would(tmp_path):
    folder = tmp_path / "patterns"
    manifest = patterns(folder).manifest
    scenes = list(np.random.default_rng(1).random((3, *SHAPE)) * np.array([1, 0, 3])[:, None, None])
    flow = virtual_run(folder, scenes, tmp_path / "a.ptu")
    ticks, _ = read_markers(tmp_path / "a.ptu")
    assert len(ticks) == 3 * len(manifest.frames)
    starts = ticks * read_header(tmp_path / "a.ptu").tick_s
    np.testing.assert_allclose(np.diff(starts), np.tile(manifest.picture_s, 3)[:-1], atol=1e-9)
    ends = np.append(ticks[1:], ticks[-1] + round(manifest.picture_s[-1] / 1e-12))
    counts = count_gates(tmp_path / "a.ptu", ticks, ends)[:, 0]
    expected = (flow[..., 0] * manifest.picture_s).ravel()
    assert (np.abs(counts - expected) < 5 * np.sqrt(expected) + 5).all()
    assert expected.max() > 1000
    virtual_run(folder, scenes, tmp_path / "b.ptu")
    assert (tmp_path / "a.ptu").read_bytes() == (tmp_path / "b.ptu").read_bytes()
    rng = np.random.default_rng(0)
    write_photons(tmp_path / "c.ptu", manifest, flow, Camera(dark=2e3), rng)
    assert (tmp_path / "a.ptu").read_bytes() == (tmp_path / "c.ptu").read_bytes()


def test_a_scan_that_fails_leaves_no_file(tmp_path):
    patterns(tmp_path / "patterns")

    def scenes():
        yield np.ones(SHAPE)
        raise KeyboardInterrupt

    display = Display()
    projector = VirtualProjector(lambda: display.scene)
    projector.load(tmp_path / "patterns")
    counter = VirtualCounter(projector, Camera(), 1e6)
    with pytest.raises(KeyboardInterrupt), counter:
        scan(projector, counter, scenes(), display.show, tmp_path / "a.ptu")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["patterns"]
    with pytest.raises(InputError, match="nothing is recorded"):
        counter.stop()


def test_virtual_devices_say_what_comes_first(tmp_path):
    projector = VirtualProjector(lambda: np.ones(SHAPE))
    with pytest.raises(InputError, match="load a pattern folder first"):
        projector.run()
    patterns(tmp_path / "patterns")
    projector.load(tmp_path / "patterns")
    projector.run()
    counter = VirtualCounter(projector, Camera(), 1e6)
    counter.start(tmp_path / "a.ptu")  # the pass before is not in it
    with pytest.raises(InputError, match="nothing is recorded"):
        counter.stop()
    (tmp_path / "patterns" / "frames.npy").write_bytes(b"")
    with pytest.raises(InputError):
        projector.load(tmp_path / "patterns")
