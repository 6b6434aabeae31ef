"""The light of a run, checked against what it should be."""

from deepfsi.hardware.light.checks import SPOILING, Fault, check_light, find_lateness
from deepfsi.hardware.light.curves import (
    CERTAIN_SIGMAS,
    FALSE_ALARMS,
    PARTS_OF_FRAME,
    Arrivals,
    excess_chance,
    name_inputs,
)
from deepfsi.hardware.light.monitor import NO_LIGHT, LightMonitor

__all__ = [
    "CERTAIN_SIGMAS",
    "FALSE_ALARMS",
    "NO_LIGHT",
    "PARTS_OF_FRAME",
    "SPOILING",
    "Arrivals",
    "Fault",
    "LightMonitor",
    "check_light",
    "excess_chance",
    "find_lateness",
    "name_inputs",
]
