"""The reference target: what a camera makes of it is found from counts behind few masks."""

import numpy as np
import pytest
from scipy import ndimage

from deepfsi.base.errors import InputError
from deepfsi.camera.device import Device
from deepfsi.camera.layout import DmdLayout
from deepfsi.counting.recording import Recording
from deepfsi.datasets.display import read_display
from deepfsi.lab.registration import WELL, check_view, write_reference
from deepfsi.lab.virtual_optics import CAMERAS, VirtualCamera
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.rails import DesignRails
from shared.virtual_runs import record

DEVICE = Device(name="d", columns=256, rows=192, shortest_us=10, settle_us=2)
PLAIN = DmdLayout()


def masks(number: int = 16) -> np.ndarray:
    """Smooth grey masks (1, m, 64), as learned ones are."""
    grey = ndimage.gaussian_filter(np.random.default_rng(0).random((number, 8, 8)), (0, 1, 1))
    grey -= grey.min(axis=(1, 2), keepdims=True)
    grey /= grey.max(axis=(1, 2), keepdims=True)
    return grey.reshape(1, number, 64) / number


def export(folder, layout=PLAIN, number=16):
    design = DesignRails(masks(number), "equal-dwell", (8, 8), 20.0)
    shown = Patterns.from_rails(design, DEVICE, 1e-3, layout=layout).write(folder)
    write_reference(shown.manifest, folder)
    return shown


def view(layout=PLAIN, scale=1.0, shift=(0.0, 0.0), turn=0.0):
    """Homography of a display that lies so on the device; shifts down and across, degrees."""
    angle = np.deg2rad(turn)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    linear = scale * rotation @ np.array(layout.orientation)
    start = 0.5 + np.array(shift[::-1]) - linear.sum(axis=1) / 2
    return (*linear[0], start[0]), (*linear[1], start[1]), (0.0, 0.0, 1.0)


def found(tmp_path, camera, flux=3e8, exposure=0.01):
    x = read_display(tmp_path / "p" / "reference.png").x
    run = record(tmp_path / "run", tmp_path / "p", x, camera, flux, exposure, seed=0)
    Recording.read(run).count()
    return check_view(run)


@pytest.mark.parametrize(
    ("layout", "place"),
    [
        (PLAIN, {}),
        (PLAIN, {"shift": (0.0, 0.125)}),
        (PLAIN, {"scale": 0.9, "turn": 4.0, "shift": (0.03, -0.05)}),
        (DmdLayout(rotate=90), {"scale": 0.5}),
        *((each, {}) for each in PLAIN.orientations()[2:5:2]),
    ],
    ids=str,
)
def test_law_the_place_of_a_scene_is_found_with_stray_light(tmp_path, layout, place):
    """Each number within five of its standard errors, in silence until now: scenes turned by 180
    degrees or flipped, shifted by a pixel of 8, at half their size."""
    export(tmp_path / "p")
    camera = VirtualCamera(view=view(layout, **place), ambient=1e6)
    fit = found(tmp_path, camera, flux=1e9)
    assert fit.doubt is None
    assert fit.layout.orientation == layout.orientation
    assert fit.fits == (layout == PLAIN and not place)
    down, across = place.get("shift", (0.0, 0.0))
    wanted = place.get("scale", 1.0), place.get("turn", 0.0), down, across
    numbers = zip(WELL, wanted, (0.003, 0.2, 0.003, 0.003), strict=False)
    for name, number, floor in numbers:
        assert abs(fit.pose[name] - number) < 5 * fit.errors[name] + floor


def test_little_light_is_said_to_be_too_little(tmp_path):
    export(tmp_path / "p")
    fit = found(tmp_path, CAMERAS["ideal"], flux=1e6)
    assert not fit.fits
    assert "too little light to be certain: record the reference with" in fit.doubt


def test_few_masks_are_refused(tmp_path):
    export(tmp_path / "p", number=5)
    with pytest.raises(InputError, match=r"5 readouts do not tell .*hadamard --size 8x8"):
        found(tmp_path, CAMERAS["ideal"], exposure=1e-3)


@pytest.mark.parametrize("inverted", [False, True])
def test_mirrors_of_the_other_polarity_are_named_and_corrected(tmp_path, inverted):
    export(tmp_path / "p", DmdLayout(invert=inverted))
    camera = VirtualCamera(inverted=True)
    if inverted:
        assert found(tmp_path, camera).fits
    else:
        with pytest.raises(InputError, match=r"with --invert if mirrors are inverted"):
            found(tmp_path, camera)


@pytest.mark.parametrize("cells", [0.3, 1.5])
def test_law_the_blur_of_the_target_is_found_and_refused_beyond_half_a_cell(tmp_path, cells):
    """Within five of its standard errors: a blur was fitted before, and not said."""
    shown = export(tmp_path / "p")
    camera = VirtualCamera(blur=cells * np.sqrt(shown.manifest.grid.mirrors))
    fit = found(tmp_path, camera, flux=1e9)
    assert fit.doubt is None
    assert abs(fit.pose["blur"] - cells) < 5 * fit.errors["blur"] + 0.1
    assert fit.fits == (cells < 0.5)
    if cells > 0.5:
        assert fit.departures == ["blur"]
