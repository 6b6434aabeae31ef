"""The light of scenes, held against that of a design's training."""

from typing import TYPE_CHECKING

import numpy as np

from deepfsi.camera import TOO_DIM
from deepfsi.hardware.light import Fault

if TYPE_CHECKING:
    from deepfsi.design.artifact import Design


def dim_scenes(design: "Design", budgets: np.ndarray) -> list[Fault]:
    """Scenes whose budgets (S,) are far below those that a design was trained for."""
    trained = design.info.get("job", {}).get("photons")
    if trained is None:
        return []
    return [
        Fault(
            kind="budget",
            scene=scene,
            detail=f"{budgets[scene]:.3g} photons are too little light for this design, which was "
            f"trained for {trained:g}: give more light, or a longer exposure",
        )
        for scene in np.flatnonzero(budgets * TOO_DIM < trained).tolist()
    ]
