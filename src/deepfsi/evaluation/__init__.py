"""How well a design works, and why: tests, ideal observer, bounds, confidence, early stopping."""

from deepfsi.evaluation.accuracy import camera_for, check_draws, evaluate
from deepfsi.evaluation.bounds import cramer_rao, linear_bound
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
from deepfsi.evaluation.stopping import (
    Estimate,
    Stopped,
    StoppingRule,
    rule_of,
    stop,
    with_rule,
)

__all__ = [
    "CalibrationScenes",
    "Estimate",
    "Exposed",
    "IdealObserver",
    "LeftOutTest",
    "Stopped",
    "StoppingRule",
    "camera_for",
    "check_draws",
    "check_playable",
    "cramer_rao",
    "evaluate",
    "fit_temperatures",
    "ideal_observer",
    "linear_bound",
    "logits_at_stops",
    "measure_left_out",
    "of_page",
    "playable",
    "rule_of",
    "stop",
    "with_rule",
]
