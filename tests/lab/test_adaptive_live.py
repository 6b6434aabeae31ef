"""Laws of a live run with adaptive masks: each is made, loaded, shown and counted in its turn."""

import shutil
from base64 import b64decode

import numpy as np
import pytest

from conftest import exposing
from deepfsi import InputError, learn, load_design
from deepfsi.lab.design_data import design_rails
from deepfsi.lab.live import LiveRun
from deepfsi.lab.results import read_log
from deepfsi.patterns.folder import Patterns
from shared.live_samples import (
    DEVICE,
    OPTICS,
    Counted,
    check_accuracy,
    live,
    make_patterns,
    scenes_of,
)

LOOKS, FLUX, EXPOSURE_S = 5, 1e7, 10e-3


def exported(folder, data, optics="one detector"):
    return make_patterns(folder, data, optics, masks=LOOKS, photons=FLUX * EXPOSURE_S)


@pytest.fixture(scope="module")
def patterns(digits, tmp_path_factory):
    return exported(tmp_path_factory.mktemp("adaptive"), digits)


def run(folder, patterns, data, **settings):
    return live(folder, patterns, data, exposure_s=EXPOSURE_S, flux=FLUX, **settings)


def masks_of(shown) -> np.ndarray:
    """Masks (looks, N) of a scene, from the record."""
    bits = [np.frombuffer(b64decode(mask), np.uint8) for each in shown.lists for mask in each.masks]
    return np.unpackbits(np.stack(bits), axis=1)[:, :64]


@pytest.mark.parametrize("optics", OPTICS)
def test_counts_are_those_of_the_masks_that_were_made(digits, tmp_path, optics, monkeypatch):
    """Poisson, with the mean that the light through each mask has in its gate."""
    patterns, (x, _) = exported(tmp_path, digits, optics), scenes_of(digits, 12)
    found = Counted(monkeypatch)
    run(tmp_path / "run", patterns, digits, count=12)
    found.check_file(tmp_path / "run")
    manifest, z = Patterns.read(patterns).manifest, []
    cells = np.array(manifest.detectors.cells if manifest.detectors else [0] * 64)
    looks = [each[0] for each in found.lists if len(each) == 1]
    for shown in read_log(tmp_path / "run"):
        counted = np.array(looks[shown.scene * LOOKS :][:LOOKS])
        gates_s = np.array([each.gate_ns[0] for each in shown.lists[1:-1]]) * 1e-9
        light = masks_of(shown) * x[shown.scene].ravel()
        arms = [light, x[shown.scene].ravel() - light][: 2 if manifest.two_arm else 1]
        each = [arm[:, cells == d].sum(axis=1) for arm in arms for d in range(cells.max() + 1)]
        rates = np.stack(each, axis=1) * FLUX / manifest.summed_reflectance
        expected = rates * gates_s[:, None]
        assert (counted[expected == 0] == 0).all()
        lit = expected > 20
        z.append(((counted - expected) / np.sqrt(expected.clip(min=1e-9)))[lit])
    z = np.concatenate(z)
    assert abs(z.mean()) < 5 / np.sqrt(len(z))
    assert abs(np.mean(z**2) - 1) < 5 * np.sqrt(2.1 / len(z))


def test_decisions_are_those_of_the_design(digits, patterns, tmp_path):
    """Accuracy of the virtual camera, and of the design's own exposures of the same scenes."""
    decided = run(tmp_path / "run", patterns, digits, count=50)
    design = load_design(patterns.parent / "adaptive.safetensors")
    check_accuracy(decided, design, digits, FLUX * EXPOSURE_S)


def test_another_design_beside_the_first_mask_is_refused(patterns, tmp_path):
    folder = shutil.copytree(patterns, tmp_path / "patterns")
    with (folder / "design.safetensors").open("ab") as file:
        file.write(b" ")
    with pytest.raises(InputError, match="is not the design whose patterns"):
        LiveRun(Patterns.read(folder), (), EXPOSURE_S)


@pytest.mark.usefixtures("trained_once")
@pytest.mark.parametrize("growth", [8.0, 1 / 8])
def test_the_shortest_look_must_not_be_shorter_than_the_device_allows(digits, tmp_path, growth):
    """Of looks of different lengths, wherever it comes."""
    design = learn(digits.hold_out(1200), design="adaptive", masks=LOOKS, photons=1e4)
    uneven = design.prior_exposure.settings.model_copy(update={"growth": growth})
    file = exposing(design, settings=uneven).save(tmp_path / "adaptive.safetensors")
    patterns, scenes = tmp_path / "patterns", scenes_of(digits, 1)[1]
    Patterns.from_rails(design_rails(file), DEVICE, 1e-3).write(patterns)
    run = LiveRun(Patterns.read(patterns), scenes, EXPOSURE_S)
    exposure_s = run.settings.live.shortest_ns * 1e-9 / min(uneven.shares)
    LiveRun(Patterns.read(patterns), scenes, exposure_s * 1.01)
    with pytest.raises(InputError, match="do not fit 64x48"):
        LiveRun(Patterns.read(patterns), scenes, exposure_s * 0.99)
