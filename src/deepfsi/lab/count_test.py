"""The test of counts, shared by recorded and live runs, tables and pictures.

It asks four questions. Was there enough light? Has each exposure counts of its own? Do they look
like those of the training? Does the camera see scenes as the training did?
"""

from collections import deque
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from deepfsi.camera.light import TOO_DIM
from deepfsi.counting.acquisition import Scene
from deepfsi.counting.checks import Fault
from deepfsi.counting.counts import Counts
from deepfsi.designfile.misfit import FALSE_ALARM, UsualMisfit
from deepfsi.designfile.view_test import SceneModel, SceneReadouts, ViewResult, ViewTest

if TYPE_CHECKING:  # it imports torch, which the command line loads late
    from deepfsi.design.design import Design

DARK_LABEL = "dark"
"""Label of scenes without light, whose places tell a display that lags."""


class CountTest:
    """Test of the counts of scenes of a design, one after another or all together."""

    def __init__(self, design: "Design") -> None:
        self._design = design
        self._trained = design.info.get("job", {}).get("photons")
        # A run is doubted by its last 20 scenes: what was sound before says nothing of now
        self._unlike: deque[bool] = deque(maxlen=20)

    @cached_property
    def model(self) -> SceneModel | None:
        """Model of the training's scenes; it is of photons, and clicks are none."""
        design = self._design
        if design.camera.clicks is not None:
            return None
        made = design.exposure.makes_masks
        return design.prior_exposure.prior.model if made else design.scene_model

    @cached_property
    def usual(self) -> UsualMisfit | None:
        """Misfit that counts are compared with; None if they are not tested."""
        if self.model is None:
            return None
        made = self._design.exposure.makes_masks
        return (self._design.prior_exposure if made else self._design).usual_misfit

    @cached_property
    def _view(self) -> ViewTest | None:
        trained = self._design.training_scenes
        if self.model is None or trained is None or len(trained.hashes) < 100:
            return None
        return ViewTest(self.model, self._design.image_shape)

    def to_be_dark(self, scenes: Sequence[Scene]) -> np.ndarray:
        """Scenes (S,), bool, that are shown without light: `dark`, unless that is a class."""
        told = DARK_LABEL not in self._design.classes
        return np.array([told and scene.label == DARK_LABEL for scene in scenes])

    def find_dim(self, budgets: np.ndarray, first: int = 0) -> list[Fault]:
        """Faults of scenes, from `first`, whose budgets (S,) are far below the training's."""
        if self._trained is None:
            return []
        return [
            Fault(
                kind="budget",
                scene=first + scene,
                detail=f"{budgets[scene]:.3g} photons are too little light for this design, which "
                f"was trained for {self._trained:g}: give more light, or a longer exposure",
            )
            for scene in np.flatnonzero(budgets * TOO_DIM < self._trained).tolist()
        ]

    @staticmethod
    def find_repeated(counts: Counts) -> list[Fault]:
        """Faults of scenes with the photon counts of another exposure, as a sound run has not."""
        from scipy.special import gammaln, xlogy

        rows = counts.counts.reshape(counts.valid.size, -1).astype(float)
        if counts.gates is not None or (rows % 1).any():  # a converter's values may repeat
            return []
        # No light makes counts k likelier than its own mean k does: k^k exp(-k) / k!
        likeliest = (xlogy(rows, rows) - rows - gammaln(rows + 1)).sum(axis=1)
        _, first, times = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
        pairs = len(rows) ** 2 / 2
        repeated = (times[first] > 1) & (likeliest < np.log(FALSE_ALARM / pairs))
        detail = "its counts are those of another exposure: look at what wrote them"
        scenes = np.unique(np.flatnonzero(repeated) // counts.valid.shape[1])
        return [Fault(kind="repeated", scene=scene, detail=detail) for scene in scenes.tolist()]

    def find_unlike(self, scene: int, scenes: int, p_value: float) -> tuple[list[Fault], bool]:
        """Faults of the next of `scenes` scenes of a run, and whether the run is refused.

        `p_value` is that of its counts by the usual misfit.
        """
        from scipy.special import bdtrc

        self._unlike.append(p_value < FALSE_ALARM)
        unlike = sum(self._unlike)
        tested = len(self._unlike)
        detail = f"its counts do not look like those of the training (p = {p_value:.1g})"
        # a class may be unlike the training twice as often as all are
        refused = bool(bdtrc(unlike - 1, tested, 2 * FALSE_ALARM) * scenes < FALSE_ALARM)
        if refused:
            detail = (
                f"{unlike} of the last {tested} scenes do not look like those of the training: "
                "look at the light, the design, the scenes and their scale, the order of frames, "
                "`dead_time` and `photons`"
            )
        faults = [Fault(kind="unlike", scene=None if refused else scene, detail=detail)]
        return faults if self._unlike[-1] or refused else [], refused

    def see(self, readouts: SceneReadouts) -> ViewResult | None:
        """Add a scene, and give the view of the camera on all so far; None if it is not tested."""
        if self._view is None:
            return None
        self._view.add(readouts)
        return self._view.result
