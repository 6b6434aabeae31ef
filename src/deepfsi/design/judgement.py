"""Answers to the counts of a camera's run, with the two tests of these counts.

All counts of a scene together are compared with those of the training, and all scenes with the
views that a camera may have of them: mirrored, blurred, with stray light.
"""

from dataclasses import dataclass

import numpy as np

from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.design.design import Design
from deepfsi.designfile.distribution import ConsistencyResult
from deepfsi.designfile.view_test import SceneReadouts, ViewResult, ViewTest


@dataclass(frozen=True, eq=False)
class RunCounts:
    """Counts of S scenes, with R exposures of each."""

    signal: np.ndarray  # (S, R, rails, m, D), counts less the background
    budgets: np.ndarray  # (S,), budget Φ of an exposure of each scene
    often: np.ndarray  # (S,), sound exposures of each scene
    sums: np.ndarray  # (S, rails, m, D), signal of the sound exposures of each scene together
    noise: np.ndarray  # (S, rails, m, D), their variance beyond that of Poisson counts


@dataclass(frozen=True, eq=False)
class Judgement:
    """Answers to counts, and what the tests of these say."""

    chances: np.ndarray  # (S, R, C), probabilities of the classes of each exposure
    consistency: ConsistencyResult | None  # of the scenes with sound exposures
    view: ViewResult | None  # None of a design without a model of its scenes, and of clicks


def judge(design: Design, counts: RunCounts) -> Judgement:
    """Answer the counts of a run by a design as its patterns realise it, and test them."""
    consistency = None
    if design.distribution is not None:
        some = counts.often > 0
        budget = (counts.budgets * counts.often)[some]
        signal, noise = (design.readouts(each[some]) for each in (counts.sums, counts.noise))
        consistency = design.consistency(signal, budget, noise)
    view = None
    if design.scene_model is not None and design.gates is None:
        view = _view_of(design, counts)
    chances = design.classify(design.readouts(counts.signal), counts.budgets[:, None])
    return Judgement(chances, consistency, view)


def _view_of(design: Design, counts: RunCounts) -> ViewResult | None:
    """Test of how the camera saw the scenes, of photon counts."""
    assert design.scene_model is not None
    rails = design.rails.stacked.cpu().numpy().astype(float)[..., None, :]
    labels = design.detection.labels
    if labels is not None:
        rails = rails * (labels.cpu().numpy() == np.arange(design.detection.count)[:, None])
    shape = rails.shape[:-1]  # (rails, m, D)
    two_arms = LIGHT_LAWS[design.light].arms == 2
    arms = np.arange(shape[0]) if two_arms else np.zeros(shape[0], int)
    inputs = np.broadcast_to(arms[:, None, None] * shape[2] + np.arange(shape[2]), shape)
    test = ViewTest(design.scene_model, design.image_shape)
    for scene in np.flatnonzero(counts.often).tolist():
        gain = counts.budgets[scene] * counts.often[scene] / design.summed_reflectance
        readouts = SceneReadouts(
            masks=gain * rails.reshape(-1, rails.shape[-1]),
            counts=counts.sums[scene].ravel(),
            noise=counts.noise[scene].ravel(),
            inputs=inputs.ravel(),
        )
        test.add(readouts)
    return test.result
