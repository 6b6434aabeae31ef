"""How well a design works, and why: tests, ideal observer, bounds, confidence, early stopping."""

from deepfsi.evaluation.accuracy import camera_for, check_draws, evaluate
from deepfsi.evaluation.bounds import cramer_rao, information_rate
from deepfsi.evaluation.confidence import (
    CalibrationScenes,
    Exposed,
    LeftOutTest,
    fit_temperatures,
    logits_at_stops,
    measure_left_out,
)
from deepfsi.evaluation.distribution_fit import find_distribution, sample_scenes
from deepfsi.evaluation.ideal import IdealObserver, ideal_observer
from deepfsi.evaluation.page_data import check_playable, of_page, playable
from deepfsi.evaluation.stopping import MeanEstimate, Stopped, share_light, stop, with_rule

__all__ = [
    "CalibrationScenes",
    "Exposed",
    "IdealObserver",
    "LeftOutTest",
    "MeanEstimate",
    "Stopped",
    "camera_for",
    "check_draws",
    "check_playable",
    "cramer_rao",
    "evaluate",
    "find_distribution",
    "fit_temperatures",
    "ideal_observer",
    "information_rate",
    "logits_at_stops",
    "measure_left_out",
    "of_page",
    "playable",
    "sample_scenes",
    "share_light",
    "stop",
    "with_rule",
]
