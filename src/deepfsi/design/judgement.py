"""Answers to the counts of a camera's run, with the two tests of these counts.

All counts of a scene together are compared with those of the training, and all scenes with the
views that a camera may have of them: mirrored, blurred, with stray light.
"""

from dataclasses import dataclass

import numpy as np

from deepfsi.camera import LIGHT_LAWS
from deepfsi.design.design import Design
from deepfsi.designfile import ConsistencyResult, SceneReadouts, ViewResult, ViewTest


@dataclass(frozen=True, eq=False)
class RunCounts:
    """Counts of S scenes, with R exposures of each.

    Attributes
    ----------
    signal : array, shape (S, R, rails, m, D)
        Counts less the background.
    budgets : array, shape (S,)
        Budget Φ of an exposure of each scene.
    often : array of int, shape (S,)
        Sound exposures of each scene.
    sums : array, shape (S, rails, m, D)
        Signal of the sound exposures of each scene together.
    noise : array, shape (S, rails, m, D)
        Their variance beyond that of Poisson counts.
    """

    signal: np.ndarray
    budgets: np.ndarray
    often: np.ndarray
    sums: np.ndarray
    noise: np.ndarray


@dataclass(frozen=True, eq=False)
class Judgement:
    """Answers to counts, and what the tests of these say.

    Attributes
    ----------
    chances : array, shape (S, R, C)
        Probabilities of the classes of each exposure.
    consistency : ConsistencyResult or None
        Of the scenes with sound exposures; None of a design without a distribution.
    view : ViewResult or None
        None of a design without a model of its scenes, and of clicks.
    """

    chances: np.ndarray
    consistency: ConsistencyResult | None
    view: ViewResult | None


def judge(design: Design, counts: RunCounts) -> Judgement:
    """Answer the counts of a run by a design as its patterns realise it, and test them.

    Parameters
    ----------
    design : Design
    counts : RunCounts

    Raises
    ------
    InputError
        As of `Design.classify` and `Design.consistency`.
    """
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
