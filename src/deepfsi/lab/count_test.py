"""The test of counts, shared by recorded and live runs, tables and pictures.

It asks four questions. Was there enough light? Has each exposure counts of its own? Do they look
like those of the training? Does the camera see scenes as the training did?
"""

from collections import deque
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from deepfsi.camera.light import TOO_DIM
from deepfsi.counting.checks import Fault
from deepfsi.counting.counts import Counts
from deepfsi.designfile.distribution import REFUSED, UNSURE, ConsistencyResult
from deepfsi.designfile.view_test import FALSE_ALARM, SceneReadouts, ViewResult, ViewTest

if TYPE_CHECKING:  # it imports torch, which the command line loads late
    from deepfsi.design.design import Design


class CountTest:
    """Test of the counts of scenes of a design, one after another or all together."""

    def __init__(self, design: "Design") -> None:
        self._design = design
        self._trained = design.info.get("job", {}).get("photons")
        # A run is doubted by its last 20 scenes: what was sound before says nothing of now
        self._unsure: deque[bool] = deque(maxlen=20)

    @cached_property
    def _view(self) -> ViewTest | None:
        design = self._design
        model = design.scene_model
        if design.exposure.makes_masks:
            model = design.prior_exposure.prior.model
        # The model is of photons, and clicks are not in proportion to them
        clicks = design.camera.clicks is not None
        return None if model is None or clicks else ViewTest(model, design.image_shape)

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

    def compare(
        self, counts: np.ndarray, photons: np.ndarray, noise: np.ndarray
    ) -> ConsistencyResult | None:
        """Compare counts (S, rails, m[, D]) with the training's; None if the design lacks them."""
        design = self._design
        if design.distribution is None:
            return None
        return design.consistency(design.readouts(counts), photons, design.readouts(noise))

    def find_unlike(self, scene: int, scenes: int, p_value: float, misfit: str) -> list[Fault]:
        """Faults of a scene of a live run, by the p-value of its misfit."""
        from scipy.special import bdtrc

        self._unsure.append(p_value < UNSURE)
        unsure = sum(self._unsure)
        tested = len(self._unsure)
        faults = []
        if p_value < UNSURE:
            detail = (
                "its counts do not look like what this design was trained for (p = "
                f"{p_value:.1g}; {misfit})"
            )
            faults.append(Fault(kind="unsure", scene=scene, detail=detail))
        if bdtrc(unsure - 1, tested, 2 * UNSURE) * scenes < REFUSED:
            detail = (
                f"{unsure} of the last {tested} scenes do not look like those of the training: "
                "look at the light, the design, the scenes and their scale, and `dead_time`"
            )
            faults.append(Fault(kind="unlike", scene=scene, detail=detail))
        return faults

    def see(
        self,
        masks: np.ndarray,
        photons: np.ndarray | float,
        counts: np.ndarray,
        noise: np.ndarray,
        arms: np.ndarray,
    ) -> ViewResult | None:
        """Add a scene, and give the view of the camera on all so far; None if it is not tested.

        `masks` (..., N) are shares of the light, `photons` their budgets, `counts` (..., D) are
        without the dark ones, `noise` (..., D) is their variance beyond Poisson's, `arms` (...)
        count them.
        """
        if self._view is None:
            return None
        detection = self._design.exposure.detection
        cells = 0 if detection.labels is None else detection.labels.cpu().numpy()
        detectors = np.arange(detection.count)
        # (D, N): cells of each detector; one detector sees all
        sees = np.equal.outer(detectors, cells)
        gain = np.asarray(photons / self._design.summed_reflectance)[..., None, None]
        seen = gain * (masks[..., None, :] * sees)
        inputs = np.broadcast_to(arms[..., None] * len(detectors) + detectors, seen.shape[:-1])
        self._view.add(
            SceneReadouts(
                masks=seen.reshape(-1, seen.shape[-1]),
                counts=counts.ravel(),
                noise=noise.ravel(),
                inputs=inputs.ravel(),
            )
        )
        return self._view.result
