"""Laws of the loop's networks: they do what the design does, in NumPy, from a file of their own."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import quick
from deepfsi.base.errors import InputError
from deepfsi.camera.stop_rule import StopRule
from deepfsi.design.artifact import Design
from deepfsi.design.stopping import StoppingRule
from deepfsi.hardware.live.loop import read_loop
from shared.design_files import loop_of

OPTICS = {
    "single": {"light": "free-dwell", "rails": "single"},
    "dual": {"light": "free-dwell", "rails": "dual", "readout": "both"},
    "two arms": {"light": "two-arm", "readout": "difference"},
    "two arms, both read": {"light": "two-arm", "readout": "both"},
    "detectors": {"light": "free-dwell", "rails": "single", "detectors": "2x2"},
    "shortest dwell": {"light": "free-dwell", "rails": "single", "shortest_dwell": 0.08},
}


@pytest.fixture(scope="module", params=OPTICS)
def design(request, digits) -> Design:
    return quick(digits, masks=5, looks=3, photons=1e3, **OPTICS[request.param])


def test_a_loop_says_and_chooses_what_the_design_does(design):
    """Through all looks, with any counts."""
    loop, rng = loop_of(design), np.random.default_rng(0)
    shape, photons = design.counts_shape, 1e3
    rails = (loop.header.rails, loop.header.masks, loop.header.detectors)
    asked: list[np.ndarray] = []
    counts = rng.poisson(photons * float(design.shares.mean()) / 3, (3, *shape))

    def read(dwell):
        asked.append(design.exposure.dwells.by_mask(dwell))
        return counts[len(asked) - 1]

    wanted = design.classify_live(read, photons)
    features, dwell = np.zeros(loop.header.features), np.zeros(loop.header.frames)
    for look in range(3):
        chosen = loop.choose(loop.inputs(features, dwell), look)
        np.testing.assert_allclose(chosen, asked[look], rtol=1e-4)
        features = features + loop.features(counts[look].reshape(rails)) / photons
        dwell = dwell + asked[look]
    inputs = loop.inputs(features, dwell)
    np.testing.assert_allclose(loop.classify(inputs, photons), wanted, atol=1e-5)
    assert loop.classify(inputs, 1e-3 * photons).max() < 0.5 < 5 * wanted.max()  # calibrated
    np.testing.assert_allclose(loop.first, asked[0], rtol=1e-4)


def test_a_loop_is_the_same_from_its_file(design, tmp_path):
    held = {"threshold": 0.9, "photons": 1e3}
    loop = loop_of(replace(design, info={**design.info, "stopping": held}))
    (tmp_path / "loop").write_bytes(loop.to_bytes())
    again = read_loop(tmp_path / "loop")
    assert again.header == loop.header
    assert again.header.rule == StopRule(**held)
    assert again.to_bytes() == loop.to_bytes()
    features = np.linspace(0, 0.1, loop.header.features)
    dwell = np.full(loop.header.frames, 1 / loop.header.frames)
    inputs = loop.inputs(features, dwell)
    wanted = loop.classify(inputs, 300)
    assert np.array_equal(again.classify(again.inputs(features, dwell), 300), wanted)


def test_a_damaged_loop_is_refused(digits, tmp_path):
    loop = loop_of(quick(digits, masks=4, looks=2, **OPTICS["single"]))
    path = tmp_path / "loop.safetensors"
    with pytest.raises(InputError, match="missing"):
        read_loop(path)
    path.write_bytes(loop.to_bytes()[:-10])
    with pytest.raises(InputError, match="not a whole loop"):
        read_loop(path)
    path.write_bytes(replace(loop, mean=loop.mean[:-1]).to_bytes())
    with pytest.raises(InputError, match="do not fit"):
        read_loop(path)
    path.write_bytes(replace(loop, chooser=loop.chooser[1:]).to_bytes())
    with pytest.raises(InputError, match="do not fit"):
        read_loop(path)
    logs, budgets = loop.temperatures
    for bad in ((logs[1:], budgets), (logs, budgets[::-1].copy()), (logs * np.nan, budgets)):
        path.write_bytes(replace(loop, temperatures=bad).to_bytes())
        with pytest.raises(InputError, match="do not fit"):
            read_loop(path)
    with pytest.raises(InputError, match="one look"):
        loop_of(quick(digits, masks=4, **OPTICS["single"]))


@pytest.mark.parametrize("photons", [300, 1e3, 1e4 / 3.1])
@pytest.mark.parametrize("confidence", [0.69, 0.71])
def test_the_rule_is_the_design_s(confidence, photons):
    chances = np.array([confidence, 0.2, 0.8 - confidence])
    wanted = StoppingRule((1, 2, 3), 0.7, 1e3).decide(1, chances, photons)
    assert StopRule(threshold=0.7, photons=1e3).stops(confidence, photons) == wanted
    assert wanted == (confidence > 0.7 and photons == 1e3)
    assert StopRule(threshold=0.7).stops(confidence, photons) == (confidence > 0.7)


def test_torch_is_not_needed():
    import subprocess
    import sys

    code = "import sys; import deepfsi.hardware.live.loop; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
