"""The reference target in a live run: how scenes lie is told by the frames that were shown."""

import numpy as np

from deepfsi.hardware.calibration import reference
from deepfsi.hardware.counting.acquisition import Scene
from deepfsi.hardware.live.run import run_live
from deepfsi.hardware.virtual.camera import VirtualCamera
from deepfsi.hardware.virtual.setup import virtual_setup
from deepfsi.lab.setup import check_view
from shared.live_samples import make_patterns, planned


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
