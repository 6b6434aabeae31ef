"""Laws of design files in NumPy: they come back byte by byte."""

import subprocess
import sys


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
