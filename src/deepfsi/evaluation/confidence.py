"""Confidence: temperatures that make the probabilities of a network agree with its accuracy.

A network is often too confident, and far too confident of counts that it was not trained for: at a
hundredth of its budget each photon is a hundred times as large among its inputs. A temperature τ
divides its logits, which keeps the order of classes. It is fitted by the log loss of scenes with
known classes and exact counts, for budgets, and for the masks or looks after which an exposure is
classified.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax

from deepfsi.camera.camera import Camera
from deepfsi.design.design import Design
from deepfsi.designfile.design_file import LOG_BOUNDS, Temperatures
from deepfsi.exposure.kind import EXPOSED_AT_ONCE, temperatures_at


class Labelled(NamedTuple):
    """Scenes of known classes, and the design that answers them."""

    design: Design
    camera: Camera  # of its exposures
    x: np.ndarray  # (n, N)
    labels: np.ndarray  # (n,)


@dataclass(frozen=True)
class CalibrationScenes:
    """Exposures of scenes of known classes, by which a design is calibrated."""

    labels: np.ndarray  # class (E,) of each exposure; a scene's exposures follow one another
    # Logits (E, C) at a budget after a number of masks or looks less 1, without `base`
    logits: Callable[[float, int], np.ndarray]
    stops: int = 1  # K, answers of an exposure
    draws: int = 1  # exposures of each scene
    base: np.ndarray | float = 0.0  # logits (C,) that a temperature does not divide
    doubt: float = 0.0  # scenes that are added to these, like them and each of any class alike

    @classmethod
    def of(
        cls, groups: Sequence[Labelled], seed: int, draws: int = 1, doubt: float = 0.0
    ) -> "CalibrationScenes":
        """Scenes that designs answer after a whole exposure."""

        def logits(photons: float, stop: int) -> np.ndarray:
            drawn = [
                draw_logits(group.design, group.camera, group.x, photons, draws, seed)
                for group in groups
            ]
            return np.concatenate(drawn)

        labels = np.concatenate([group.labels.repeat(draws) for group in groups])
        return cls(labels, logits, draws=draws, doubt=doubt)

    def losses(self, logits: np.ndarray, temperature: float) -> np.ndarray:
        """−ln of the probability (E,) of the true classes, from `logits` (E, C) of one stop."""
        logs = log_softmax(logits.astype(float) / temperature + self.base, axis=1)
        return -logs[np.arange(len(logs)), self.labels]


@dataclass(frozen=True)
class LeftOutTest:
    """Answers to scenes that a training left out, at its budget, after a whole exposure.

    Only the temperatures were fitted to these scenes. A design keeps this in its `info`.
    """

    scenes: int  # that were left out, and answered
    accuracy: float  # share of their exposures that are answered rightly
    log_loss: float  # mean −ln of the probability of the true class, in nats, with temperatures
    uncalibrated_log_loss: float  # the same without them
    guessing: float  # the same of an answer that gives each class its share of the training scenes
    error: float  # standard error of the difference of `log_loss` and `guessing`, over scenes
    guesses: bool  # whether both log losses cannot be told apart: within twice the error


def fit_temperatures(
    scenes: CalibrationScenes, budgets: np.ndarray, *, trained_on: bool
) -> Temperatures:
    """Temperatures of a design at budgets (B,), by exposures of scenes of known classes.

    A network may be surer of scenes of its training than it is right on others. So scenes that it
    was trained on may only make it less sure.
    """
    stops = scenes.stops
    # at eight numbers of masks or looks, at most
    fitted = np.unique(np.rint(np.geomspace(1, stops, 8)).astype(int)) - 1
    logs = np.array(
        [[_fit(scenes.logits(budget, stop), scenes) for stop in fitted] for budget in budgets]
    )
    if trained_on:
        logs = logs.clip(min=0)
    columns = [np.interp(np.arange(stops), fitted, column) for column in logs]
    return Temperatures(np.stack(columns, axis=1), budgets)


def measure_left_out(
    scenes: CalibrationScenes, temperatures: Temperatures, photons: float, guess: np.ndarray
) -> LeftOutTest:
    """Test of the answers to scenes that a training left out, beside guesses (C,)."""
    last = scenes.stops - 1
    logits = scenes.logits(photons, last)
    losses = scenes.losses(logits, float(temperatures_at(temperatures, last, photons)))
    # a class without training scenes would cost infinitely much
    guessed = -np.log(guess.clip(min=1e-6))[scenes.labels]
    # exposures of one scene are no scenes of their own
    gains = (losses - guessed).reshape(-1, scenes.draws).mean(axis=1)
    loss = float(losses.mean())
    guessing = float(guessed.mean())
    error = float(gains.std() / len(gains) ** 0.5)
    return LeftOutTest(
        scenes=len(gains),
        accuracy=float(((logits + scenes.base).argmax(axis=1) == scenes.labels).mean()),
        log_loss=loss,
        uncalibrated_log_loss=float(scenes.losses(logits, 1.0).mean()),
        guessing=guessing,
        error=error,
        guesses=loss + 2 * error >= guessing,
    )


def draw_logits(
    design: Design, camera: Camera, x: np.ndarray, photons: float, draws: int, seed: int
) -> np.ndarray:
    """Logits (E, C) of exposures of scenes (n, N); draws of a scene follow one another."""
    generator = torch.Generator(design.exposure.device).manual_seed(seed)
    chunks = []
    with torch.no_grad():
        for rows in torch.arange(len(x)).split(EXPOSED_AT_ONCE):
            # NumPy takes a tensor of one number for the number itself
            expose = design.exposures(torch.from_numpy(x[rows.numpy()]), camera)
            logits = [expose(photons, generator)[0].logits for _ in range(draws)]
            chunks.append(torch.stack(logits, dim=-2).flatten(-3, -2))
    return torch.cat(chunks, dim=-2).cpu().numpy()


def _fit(logits: np.ndarray, scenes: CalibrationScenes) -> float:
    """Log τ of the least log loss of logits (E, C) of calibration scenes."""
    below = logits.astype(float)  # less the largest logit of each exposure
    below -= below.max(axis=1, keepdims=True)  # so that no exponential overflows
    lost = float(-below[np.arange(len(below)), scenes.labels].mean())
    if scenes.doubt:
        # scenes of doubt have all classes alike: a mean logit stands for that of the true class
        share = scenes.doubt / (scenes.doubt + len(below) / scenes.draws)
        lost += share * (float(-below.mean()) - lost)

    def log_loss(log: float) -> float:
        # less the part of the base, which no temperature changes
        sums = np.exp(below / np.exp(log) + scenes.base).sum(axis=1)
        return lost / np.exp(log) + float(np.log(sums).mean())

    options = {"xatol": 1e-2}
    return float(minimize_scalar(log_loss, bounds=LOG_BOUNDS, method="bounded", options=options).x)


MOST_SCENES = 4096
"""Training scenes that are looked at, at most."""


def sample_scenes(count: int, readouts: int, seed: int = 0) -> np.ndarray:
    """Indices of the training scenes that are looked at, of `count`."""
    most = min(max(2**21 // readouts, 512), MOST_SCENES)
    return np.random.default_rng(seed).permutation(count)[:most]
