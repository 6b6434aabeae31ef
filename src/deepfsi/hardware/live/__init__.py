"""Live and recorded runs: devices show and count; a live run decides what is shown next."""

from deepfsi.hardware.live.looks import (
    AllOnCounts,
    ExposureState,
    FixedMaskLooks,
    FrameList,
    LookChooser,
    SceneComparison,
)
from deepfsi.hardware.live.losses import LightLosses
from deepfsi.hardware.live.observer import SceneObserver
from deepfsi.hardware.live.replay import LiveCounts, is_live, replay_run
from deepfsi.hardware.live.results import LiveAnswers, LiveScene
from deepfsi.hardware.live.run import plan_live, record_run, run_live

__all__ = [
    "AllOnCounts",
    "ExposureState",
    "FixedMaskLooks",
    "FrameList",
    "LightLosses",
    "LiveAnswers",
    "LiveCounts",
    "LiveScene",
    "LookChooser",
    "SceneComparison",
    "SceneObserver",
    "is_live",
    "plan_live",
    "record_run",
    "replay_run",
    "run_live",
]
