"""Laws of design files in NumPy: they come back byte by byte."""

import subprocess
import sys

import numpy as np
import pytest

from deepfsi.designfile.design_file import DesignFile
from shared.vectors import KINDS, write_file


def test_torch_is_not_needed():
    code = (
        "import sys\n"
        "from deepfsi.designfile.design_file import DesignFile\n"
        "from deepfsi.designfile.design_file import find_design\n"
        "file = DesignFile.read(find_design('dmd-mnist'))\n"
        "assert file.masks == file.rails.shape[1]\n"
        "assert 'torch' not in sys.modules and 'scipy.stats' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("kind", KINDS)
def test_it_holds_the_masks_of_the_vectors(kind, tmp_path):
    path, matrix, _ = write_file(kind, tmp_path)
    file = DesignFile.read(path)
    assert file.to_bytes() == path.read_bytes()
    signed = file.rails[0] - (file.rails[1] if file.rail_count == 2 else 0)
    np.testing.assert_allclose(signed, matrix, atol=1e-7)
