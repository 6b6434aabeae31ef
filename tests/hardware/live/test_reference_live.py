"""The reference target in a live run: how scenes lie is told by the frames that were shown."""

import numpy as np
import pytest

import deepfsi
from deepfsi.camera.device import find_device
from deepfsi.hardware.calibration import reference
from deepfsi.hardware.counting.acquisition import Scene
from deepfsi.hardware.live.replay import LiveCounts
from deepfsi.hardware.live.run import plan_live, run_live
from deepfsi.hardware.patterns.folder import FrameSettings, export_patterns
from deepfsi.hardware.virtual.camera import VirtualCamera
from deepfsi.hardware.virtual.setup import Latencies, virtual_setup
from deepfsi.lab.calibration import check_view
from deepfsi.lab.looks import design_rails, open_looks
from shared.live_samples import make_patterns


@pytest.mark.parametrize("adaptive", [False, True], ids=["looks", "adaptive masks"])
def test_the_reference_of_a_live_run_tells_how_scenes_lie(digits, tmp_path, adaptive):
    """Of looks and of adaptive masks, whose frames differ from scene to scene."""
    if adaptive:
        design = deepfsi.learn(digits, camera="dmd", design="adaptive", masks=16, photons=1e4)
        design.save(tmp_path / "one.safetensors")
        device = find_device("64x48").model_copy(update={"load_us": 1000})
        frames = FrameSettings(device, 1e-3)
        export_patterns(design_rails(tmp_path / "one.safetensors"), frames, tmp_path / "patterns")
    else:
        make_patterns(tmp_path, digits, masks=12)
    target, places = np.repeat(reference.TARGET[None], 2, axis=0), {}
    turned = ((-1, 0, 1), (0, -1, 1), (0, 0, 1))
    for name, view in (("as exported", None), ("turned", turned)):
        camera = VirtualCamera.model_validate({} if view is None else {"view": view})
        scenes = tuple(Scene(name=str(k)) for k in range(2))
        seen = {"flux": 5e6, "camera": camera.model_dump(mode="json")}
        looks = open_looks(tmp_path / "patterns")
        acquisition = plan_live(tmp_path / "patterns", scenes, 0.1, looks=looks, **seen)
        devices = virtual_setup(tmp_path / "patterns", target, acquisition, Latencies())
        list(run_live(tmp_path / name, tmp_path / "patterns", acquisition, devices, looks))
        LiveCounts.count(tmp_path / name)
        places[name] = check_view(tmp_path / name)
    assert places["as exported"].layout == places["as exported"].exported
    assert places["turned"].layout.rotate == 180
    assert not places["turned"].fits
