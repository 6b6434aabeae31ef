"""The claims of flexible designs answer to the numbers."""

from dataclasses import asdict

import numpy as np
import pytest

from deepfsi.evaluation import stopping
from deepfsi.evaluation.stopping import MeanEstimate, Stopped
from deepfsi_paper.flexible import claims as flexible
from deepfsi_paper.flexible import measures
from shared.results import of_three, some_results

LIGHTS = (1e3, 1e4)
SHIFTS = np.array([-0.001, 0.0, 0.001])


def point(recipe, accuracy, **fields):
    return of_three(accuracy, **{"recipe": recipe, "label": "DFSI", "title": "DeepFSI", **fields})


def rate(mean):
    return MeanEstimate(mean, mean - 0.001, mean + 0.001)


def stopped_trials(used, lost):
    """Exposures of three trials that stop early."""
    rest = dict.fromkeys(("confidence", "calibration_error", "uncalibrated_error", "log_loss"), 0.1)
    rest |= {"uncalibrated_log_loss": 0.2, "reliability": [], "stops": [0.5, 0.5]}
    rest |= {"rejection": [{"accepted": 1.0, "stopped": 0.9, "whole": 0.9}], "validation": {}}
    rest |= {"curve": [{"threshold": 1.0, "used": 1.0, "accuracy": 0.9}], "images": 10, "draws": 1}
    rule = stopping.StoppingRule(after=(1, 2), threshold=0.9, photons=1e5)
    rest |= {"photons": 1e5, "rule": rule, "whole": rate(0.9), "stopped": rate(0.9 - lost)}
    return [
        Stopped(used=rate(used + change), difference=rate(-lost + change / 1000), **rest)
        for change in SHIFTS
    ]


def results(ranged=0.9, first=0.89, used=0.6, lost=0.0, looked=0.5):
    fixed = [{"design": d, "label": d.upper(), "title": d} for d in ("pca", "truncated-hadamard")]
    points = [
        *(point("budgets", 0.9, photons=p) for p in LIGHTS),
        *(point("budgets", 0.7, photons=p, **design) for p in LIGHTS for design in fixed),
        point("counts", 0.9, masks=10),
        *(point("counts", 0.7, masks=10, **design) for design in fixed),
        *(point("range", ranged, photons=p, trained_at=2e2) for p in LIGHTS),
        point("nested", 0.9),
        point("stop", 0.9, photons=1e5),
        *(point("plain", 0.9, photons=p) for p in (5e4, 1e5)),
    ]
    prefixes = [
        measures.Prefix(
            recipe, masks, masks / 1024, 1e4, tuple(each + SHIFTS), each, each - 0.002, each + 0.002
        )
        for recipe in ("nested", "both")
        for masks, each in ((10, first), (92, 0.9))
    ]
    trials = stopped_trials(used, lost), stopped_trials(looked, 0.0)
    return some_results(points, extra=asdict(measures.Measures(prefixes, *trials)))


@pytest.mark.parametrize(
    ("changes", "answers"),
    [
        ({}, [True, True, True, True]),
        ({"ranged": 0.88}, [False, True, True, True]),
        ({"first": 0.88}, [True, False, True, True]),
        ({"used": 0.8}, [True, True, False, True]),
        ({"lost": 0.01}, [True, True, False, True]),
        ({"looked": 0.8}, [True, True, True, False]),
    ],
)
def test_claims_answer_to_the_numbers(changes, answers):
    claims = flexible.claims_of(flexible.Numbers(results(**changes)))
    assert [claim.holds for claim in claims] == answers
