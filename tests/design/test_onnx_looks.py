"""The graph of a design of several looks: its answers and its next dwells are those of the loop."""

import numpy as np
import pytest

from conftest import quick
from deepfsi import Design
from deepfsi.camera import share_out
from deepfsi.design import to_onnx
from shared.design_files import file_of

onnxruntime = pytest.importorskip("onnxruntime")

LOOKS = 3
OPTICS = {
    "single": {"light": "free-dwell", "rails": "single"},
    "dual": {"light": "free-dwell", "rails": "dual", "readout": "both"},
    "two arms": {"light": "two-arm", "readout": "difference"},
    "detectors": {"light": "free-dwell", "rails": "single", "detectors": "2x2"},
    "shortest dwell": {"light": "free-dwell", "rails": "single", "shortest_dwell": 0.08},
}


@pytest.fixture(scope="module", params=OPTICS)
def design(request, digits) -> Design:
    return quick(digits, masks=5, looks=LOOKS, photons=1e3, **OPTICS[request.param])


@pytest.mark.parametrize("shortest", [0.0, 0.07, 0.9])
def test_a_graph_says_and_chooses_what_the_file_does(design, shortest):
    """In each look of scenes with any counts and light, also where no frame is long enough."""
    file, rng, photons = file_of(design), np.random.default_rng(0), 10 ** (2 + shortest)
    session = onnxruntime.InferenceSession(to_onnx(design), providers=["CPUExecutionProvider"])
    assert [each.name for each in session.get_outputs()] == ["probabilities", "next"]
    dwells, batch = design.exposure.dwells, 4
    rails = (file.rail_count, file.masks, file.detector_count)
    counts = np.zeros((batch, *design.counts_shape), np.float32)
    dwell = np.zeros((batch, dwells.count))
    for look in range(LOOKS):
        given = {
            "counts": counts,
            "photons": np.full(batch, photons, np.float32),
            "dwell": dwells.by_rail(dwell).astype(np.float32),
            "left": np.full(batch, 1 - look / LOOKS, np.float32),
            "shortest": np.full(batch, shortest, np.float32),
        }
        chances, asked = session.run(None, given)
        chosen = dwells.by_mask(asked)
        for k in range(batch):
            inputs = file.inputs(file.features(counts[k].reshape(rails)) / photons, dwell[k])
            wanted = share_out(file.next_dwell(inputs, look), shortest)
            np.testing.assert_allclose(chosen[k], wanted, rtol=1e-3, atol=1e-7)
            np.testing.assert_allclose(chances[k], file.chances(inputs, photons), atol=1e-5)
        dwell = dwell + chosen
        mean = photons * float(design.shares.mean()) / LOOKS
        counts = counts + rng.poisson(mean, counts.shape).astype(np.float32)
