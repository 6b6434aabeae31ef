"""Devices as data: numbers with sources, and limits of a device of one's own."""

import math
import re
from importlib.resources import files

import pytest

from deepfsi.camera.device import DEVICES

DIAGONAL_INCHES = {
    "dlp7000": 0.7, "dlp9500": 0.95, "dlp650lnir": 0.65, "dlp6500": 0.65, "dlp9000": 0.9,
    "dlp670s": 0.67, "dlp500yx": 0.5, "dlp4500": 0.45, "dlp3010": 0.3, "dlp4710": 0.47,
    "dlp6500-dlpc910": 0.65, "dlp9000x": 0.9,
}  # fmt: skip


@pytest.mark.parametrize("name", DEVICES)
def test_mirrors_and_pitch_give_the_diagonal_of_the_name(name):
    device = DEVICES[name]
    across, down = device.columns * device.pitch_um, device.rows * device.pitch_um
    if device.lattice == "diamond":  # columns are a diagonal apart, rows half a one
        across, down = across * math.sqrt(2), down / math.sqrt(2)
    inches = math.hypot(across, down) / 25400
    assert inches == pytest.approx(DIAGONAL_INCHES[name], rel=0.05)


def test_each_number_has_a_source_or_is_said_to_be_assumed():
    content = files("deepfsi.camera").joinpath("devices.toml").read_text()
    numbers = re.findall(r"^(\w+) = [\d_.]+(.*)$", content, re.MULTILINE)
    assert len(numbers) >= 5 * len(DEVICES)
    document = r"  # .*(DLP[SU]\d{3}|thread \d|data sheet|400 MHz|DLPC900REF-SW|assumed)"
    assert not [name for name, source in numbers if not re.match(document, source)]
