"""Numbers behind the figures of the camera, as `hardware.json` holds them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deepfsi.statistics.differences import Difference, of_trials


@dataclass(frozen=True)
class DigitTest:
    """Success rates of one design with the ten digits of every draw.

    Attributes
    ----------
    design, label : str
    specific : bool
        Whether the design is feature-specific.
    masks : int
    assumed : float
        Photon budget assumed in training.
    effect : str
        What the laboratory varies, or "none".
    value : float
        Of the effect, in its unit.
    exposure_s : float
    rates : sequence, shape (draws, digits)
        Share of the exposures that are classified rightly.
    """

    design: str
    label: str
    specific: bool
    masks: int
    assumed: float
    effect: str
    value: float
    exposure_s: float
    rates: Sequence[Sequence[float]]

    @property
    def by_draw(self) -> np.ndarray:
        """Accuracy of each draw of the digits."""
        return np.mean(self.rates, axis=1)

    @property
    def accuracy(self) -> Difference:
        """Mean over draws, with its error."""
        return of_trials(self.by_draw.tolist())

    def less(self, other: "DigitTest") -> Difference:
        """Accuracy less another design's on the same digits, with its error over draws."""
        return of_trials((self.by_draw - other.by_draw).tolist())


@dataclass(frozen=True)
class RunTime:
    """Time from a photon file to its classes, for one exposure.

    Attributes
    ----------
    design, label : str
    seconds : float
    photons : int
        Counted photons.
    bytes : int
        Size of the photon file.
    """

    design: str
    label: str
    seconds: float
    photons: int
    bytes: int


@dataclass(frozen=True)
class Views:
    """Scenes as displayed, (n, h, w), and as the camera's cells see them, (n, down, across)."""

    raw: Sequence[Sequence[Sequence[float]]]
    seen: Sequence[Sequence[Sequence[float]]]
    names: Sequence[str]


@dataclass(frozen=True)
class Measures:
    """Everything that is measured in the laboratory.

    Attributes
    ----------
    calibration, camera : dict
        The fitted view and the virtual camera, as their models write themselves.
    views : Views
    frame : str
        DeepFSI's first frame in base64, a bit for each mirror.
    tests : sequence of DigitTest
    times : sequence of RunTime
    """

    calibration: dict[str, Any]
    camera: dict[str, Any]
    views: Views
    frame: str
    tests: Sequence[DigitTest]
    times: Sequence[RunTime]
