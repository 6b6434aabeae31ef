"""How well a design works, and why: tests, ideal observer, bounds, confidence, early stopping."""

from deepfsi.evaluation.accuracy import camera_for, check_draws, evaluate, scanner_for
from deepfsi.evaluation.bounds import cramer_rao
from deepfsi.evaluation.confidence import (
    CalibrationScenes,
    Exposed,
    LeftOutTest,
    fit_temperatures,
    logits_at_stops,
    measure_left_out,
)
from deepfsi.evaluation.ideal import IdealObserver, ideal_observer
from deepfsi.evaluation.page_data import check_playable, of_page, playable
from deepfsi.evaluation.stopping import MeanEstimate, Stopped, looks_of, stop, with_rule

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
    "fit_temperatures",
    "ideal_observer",
    "logits_at_stops",
    "looks_of",
    "measure_left_out",
    "of_page",
    "playable",
    "scanner_for",
    "stop",
    "with_rule",
]
