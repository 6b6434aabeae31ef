"""Light over time: what arrived in parts of frames, the curve of each arm, and exact chances.

Two windows of one light share their photons like a coin's throws, whatever its brightness: given
the sum, the photons of one are binomial with its share of the time. So no rate need be known, and
few photons are as sound a base as many.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from deepfsi.hardware.patterns.manifest import Frame

PARTS_OF_FRAME = 8
"""Parts of each frame that are counted by themselves."""

FALSE_ALARMS = 1e-3
"""Chance of any fault of the light in a sound acquisition, at most."""

EXCESS = 1.1
"""Variance of sound counts over Poisson's at most: what afterpulses of up to 5 % add."""

CERTAIN_SIGMAS = 6.0
"""Standard errors beyond which something is certain."""


@dataclass(frozen=True)
class Arrivals:
    """Photons that arrived in equal parts of frames, as estimated from those that were counted."""

    ARRAYS: ClassVar = ("photons", "variance", "seconds")

    frames: tuple[Frame, ...]  # frames in the order in which they were shown
    photons: np.ndarray
    variance: np.ndarray  # variance of their noise
    seconds: np.ndarray  # how long each part was open: 0 of frames that are not counted yet

    @classmethod
    def join(cls, lists: Sequence[Self]) -> Self:
        """Frames of lists that were shown one after another."""
        joined = (np.concatenate([getattr(one, name) for one in lists]) for name in cls.ARRAYS)
        return cls(tuple(frame for one in lists for frame in one.frames), *joined)

    @classmethod
    def stack(cls, passes: Sequence[Self]) -> Self:
        """Passes over the same frames."""
        return replace(
            passes[-1],
            photons=np.stack([one.photons for one in passes]),
            variance=np.stack([one.variance for one in passes]),
            seconds=np.stack([one.seconds for one in passes]),
        )

    def select(self, indices: Sequence[int]) -> Self:
        """Some frames of a list."""
        which = list(indices)
        selected = (getattr(self, name)[which] for name in self.ARRAYS)
        return type(self)(tuple(self.frames[index] for index in which), *selected)


@dataclass(frozen=True)
class LightCurve:
    """Light over time, of an arm's detectors together or of one of them."""

    photons: np.ndarray
    seconds: np.ndarray
    scenes: np.ndarray  # scene of each pass
    bright: tuple[int, int]
    dark: tuple[int, int]
    frames: tuple[Frame, ...]
    name: str  # what a fault calls the inputs
    sees_part: bool = False  # True of a detector that sees a part of the device, which may be dark

    def of(self, frames: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Photons and seconds of some frames, each (P, frames)."""
        which = list(frames)
        return self.photons[:, which].sum(axis=2), self.seconds[:, which].sum(axis=2)

    def together(self, frames: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Photons and seconds of some frames together, each (P,)."""
        photons, seconds = self.of(frames)
        return photons.sum(axis=1), seconds.sum(axis=1)


@dataclass(frozen=True)
class Curves:
    """Curves of each arm's detectors together, and of each detector where an arm has several."""

    arms: tuple[LightCurve, ...]
    detectors: tuple[LightCurve, ...]

    @classmethod
    def of(cls, arrivals: Arrivals, scenes: np.ndarray, wired: Sequence[tuple[int, ...]]) -> Self:
        """Curves of passes (P) of these scenes (P,); `wired`: inputs of each arm's detectors."""
        last = len(arrivals.frames) - 1
        on = (0, last - 1)
        off = (1, last)
        arms = []
        detectors = []
        for arm, inputs in enumerate(wired):
            first = arm * len(inputs)
            photons, seconds = _as_poisson(arrivals, slice(first, first + len(inputs)))
            together = LightCurve(
                photons,
                seconds,
                scenes,
                bright=on if arm == 0 else off,
                dark=off if arm == 0 else on,
                frames=arrivals.frames,
                name=f" on input {name_inputs(inputs)}" if len(wired) > 1 else "",
            )
            arms.append(together)
            for column, number in enumerate(inputs if len(inputs) > 1 else (), first):
                photons, seconds = _as_poisson(arrivals, slice(column, column + 1))
                name = f" on input {number + 1}"
                detectors.append(
                    replace(together, photons=photons, seconds=seconds, name=name, sees_part=True)
                )
        return cls(tuple(arms), tuple(detectors))

    @property
    def inputs(self) -> tuple[LightCurve, ...]:
        """Curve of each input by itself."""
        return self.detectors or self.arms

    @property
    def every(self) -> tuple[LightCurve, ...]:
        """Curves of arms, then of detectors."""
        return self.arms + self.detectors


def _as_poisson(arrivals: Arrivals, columns: slice) -> tuple[np.ndarray, np.ndarray]:
    """Photons and seconds (P, F, K) of inputs together, scaled so that noise is Poisson's."""
    photons = arrivals.photons[..., columns].sum(axis=-1)
    noise = arrivals.variance[..., columns].sum(axis=(-2, -1))
    share = np.where(noise > 0, photons.sum(axis=-1) / np.where(noise > 0, noise, 1), 1)[..., None]
    return photons * share, arrivals.seconds * share


def name_inputs(inputs: Sequence[int]) -> str:
    """Inputs as people number them: `1`, `1 and 2`, or `1 to 4`."""
    if len(inputs) > 2 and tuple(inputs) == tuple(range(inputs[0], inputs[0] + len(inputs))):
        return f"{inputs[0] + 1} to {inputs[-1] + 1}"
    return " and ".join(str(number + 1) for number in inputs)


def excess_chance(
    photons: np.ndarray,
    seconds: np.ndarray,
    others: np.ndarray,
    others_s: np.ndarray,
    ratio: np.ndarray | float = 1.0,
) -> np.ndarray:
    """Chance that a window holds so many photons or more, given the sum of it and another."""
    from scipy.special import betainc

    photons, seconds, others, others_s, ratio = np.broadcast_arrays(
        *(np.asarray(array, np.float64) for array in (photons, seconds, others, others_s, ratio))
    )
    out = np.ones(photons.shape)
    which = (photons > 0) & (seconds > 0) & (others_s > 0)
    open_s = (ratio * seconds)[which]
    share = open_s / (open_s + others_s[which])
    out[which] = betainc(photons[which] / EXCESS, others[which] / EXCESS + 1, share)
    return out


def change_chance(
    photons: np.ndarray,
    seconds: np.ndarray,
    others: np.ndarray,
    others_s: np.ndarray,
    ratio: np.ndarray | float,
) -> np.ndarray:
    """Chance that one of two windows holds so many photons more.

    `ratio` is allowed either way, and the chance is twice that of the less likely side.
    """
    more = excess_chance(photons, seconds, others, others_s, ratio=ratio)
    less = excess_chance(others, others_s, photons, seconds, ratio=ratio)
    return np.minimum(1.0, 2 * np.minimum(more, less))
