"""Laws of design files in NumPy: they come back byte by byte, and answer as the design does."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from conftest import quick
from deepfsi import Design
from deepfsi.base.errors import InputError
from deepfsi.designfile.design_file import DesignFile
from deepfsi.designfile.published import find_design
from shared.design_files import file_of
from shared.vectors import AGREES, KINDS, write_file

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


def test_it_says_and_chooses_what_the_design_does(design):
    """Through all looks, with any counts."""
    file, rng, photons = file_of(design), np.random.default_rng(0), 1e3
    asked: list[np.ndarray] = []
    mean = photons * float(design.shares.mean()) / 3
    counts = rng.poisson(mean, (3, *design.counts_shape))

    def read(dwell):
        asked.append(design.exposure.dwells.by_mask(dwell))
        return counts[len(asked) - 1]

    wanted = design.classify_live(read, photons)
    features, dwell = np.zeros(file.feature_count), np.zeros(file.frames)
    for look in range(3):
        chosen = file.next_dwell(file.inputs(features, dwell), look)
        np.testing.assert_allclose(chosen, asked[look], rtol=1e-4)
        readouts = counts[look].reshape(file.rail_count, file.masks, file.detector_count)
        features = features + file.features(readouts) / photons
        dwell = dwell + asked[look]
    inputs = file.inputs(features, dwell)
    np.testing.assert_allclose(file.chances(inputs, photons), wanted, atol=1e-5)
    assert file.chances(inputs, 1e-3 * photons).max() < 0.5 < 5 * wanted.max()  # calibrated
    np.testing.assert_allclose(file.first_dwell, asked[0], rtol=1e-4)


def test_what_it_cannot_do_is_said(good):
    file, bias = file_of(good), "classifier.layers.0.bias"
    with pytest.raises(InputError, match="one look: learn one of several `looks`"):
        file.next_dwell(np.zeros(1), 0)
    with pytest.raises(InputError, match="makes its masks while the camera looks"):
        _ = DesignFile.read(find_design("adaptive-mnist")).classifier
    fewer = {name: array for name, array in file.arrays.items() if name != bias}
    for changed in (fewer, fewer | {bias: np.zeros(1, np.float32)}):
        with pytest.raises(InputError, match="networks do not fit its masks"):
            _ = replace(file, arrays=changed).classifier


def test_torch_is_not_needed():
    code = (
        "import sys\n"
        "from deepfsi.designfile.design_file import DesignFile\n"
        "from deepfsi.designfile.published import find_design\n"
        "file = DesignFile.read(find_design('dmd-mnist'))\n"
        "file.chances(file.inputs(file.arrays['mean']), 1e4)\n"
        "assert 'torch' not in sys.modules and 'scipy.stats' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("kind", KINDS)
def test_it_answers_the_vectors(kind, tmp_path):
    path, matrix, vectors = write_file(kind, tmp_path)
    file = DesignFile.read(path)
    assert file.to_bytes() == path.read_bytes()
    signed = file.rails[0] - (file.rails[1] if file.rail_count == 2 else 0)
    np.testing.assert_allclose(signed, matrix, atol=1e-7)
    for vector in vectors:
        features = file.features(vector.counts[:, : vector.masks]) / vector.photons
        inputs = file.inputs(features, vector.dwell)
        np.testing.assert_allclose(
            file.chances(inputs, vector.photons), vector.chances, atol=AGREES
        )
        if vector.look is not None:
            dwell = file.next_dwell(inputs, vector.look)
            np.testing.assert_allclose(dwell, vector.next_dwell, atol=AGREES)
