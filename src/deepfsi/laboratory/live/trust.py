"""Trust in a scene of a live run: its budget, and its counts against those of the training."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from scipy.special import bdtrc

from deepfsi.design.consistency import REFUSED, UNSURE
from deepfsi.hardware.recording.acquisition import Acquisition
from deepfsi.hardware.recording.faults import Fault
from deepfsi.hardware.recording.live_light import LiveLight
from deepfsi.laboratory.live.loop import Loop
from deepfsi.optics.budget import TOO_DIM

LOOKED_BACK = 20
"""Scenes up to the present one among which the unsure ones are counted."""

USUAL_DEAD_S = 3e-8
"""Dead time that a counter with its detector may well have, seconds."""

SATURATED = 0.05
"""Share of the photons lost to it from which on saturation is named."""


@dataclass(frozen=True)
class SceneCounts:
    """Counts of a scene, all looks together, less the dark counts."""

    scene: int
    look: int  # the last one
    read: np.ndarray  # (rails, m, D)
    noise: np.ndarray  # (rails, m, D): Dark counts, and other variance beyond the counts' own
    dwell: np.ndarray  # (q,): Share of the exposure that each frame had
    on: float  # in the all-ON frames
    on_noise: float
    on_s: float  # time of these, seconds


class Trust:
    """Tests of scene after scene."""

    def __init__(self, loop: Loop, acquisition: Acquisition) -> None:
        assert acquisition.live is not None
        self._loop, self._exposure_s = loop, acquisition.exposure_s
        self._live, self._scenes = acquisition.live, len(acquisition.scenes)
        self._unsure: deque[bool] = deque(maxlen=LOOKED_BACK)

    def find_faults(
        self, held: SceneCounts, light: LiveLight, photons: float, measured: float
    ) -> tuple[Fault, ...]:
        """Faults of a scene, of its budget and the measured one, counts of an exposure."""
        faults, scene = [], held.scene
        stated, trained = self._live.photons, self._loop.header.photons
        if stated is not None and light.contradicts(stated / self._exposure_s):
            some = f"scenes {light.since} to {scene}" if light.since < scene else "this scene"
            detail = (
                f"`photons` says {stated:.4g} counts an exposure, and the all-ON frames of {some} "
                f"{measured:.4g}, further off than scenes differ: leave it out, or give that number"
            )
            faults.append(Fault(kind="budget", scene=scene, detail=detail))
        elif trained is not None and measured * TOO_DIM < trained:
            detail = (
                f"all-ON frames give {measured:.4g} counts an exposure, and the design was "
                f"trained at {trained:.4g}: too little light for it; expose for longer"
            )
            faults.append(Fault(kind="budget", scene=scene, detail=detail))
        return (*faults, *self._unlikely(held, photons))

    def _unlikely(self, held: SceneCounts, photons: float) -> list[Fault]:
        """Faults of counts that do not look like those of the training."""
        known, scene = self._loop.distribution, held.scene
        if known is None:
            return []
        header = self._loop.header
        frames = held.dwell * header.frames
        each = frames.reshape(header.masks, -1).T[:, :, None]
        weights = np.broadcast_to(each, held.read.shape).ravel()
        read, noise, often = (
            np.append(one, last)[None, None]
            for one, last in (
                (held.read, held.on),
                (held.noise, held.on_noise),
                (weights, held.on_s / self._exposure_s),
            )
        )
        found = known.after(held.look).test(read, np.array([photons]), noise, often)
        self._unsure.append(bool(found.unsure[0]))
        faults, seen, hint = [], len(self._unsure), self._saturation(held)
        if self._unsure[-1]:
            detail = (
                f"its counts do not look like what this design was trained for (p = "
                f"{found.exposures[0]:.1g}; {found.brightness:.2f} times the counts of its mean "
                f"scene at this budget){hint}"
            )
            faults.append(Fault(kind="unsure", scene=scene, detail=detail))
        unsure = sum(self._unsure)
        if bdtrc(unsure - 1, seen, 2 * UNSURE) * self._scenes < REFUSED:
            detail = (
                f"{unsure} of the last {seen} scenes do not look like those of the training: "
                "look at the light, the design, the scenes and their scale, `photons` and "
                f"`dead_time`{hint}"
            )
            faults.append(Fault(kind="unlike", scene=scene, detail=detail))
        return faults

    def _saturation(self, held: SceneCounts) -> str:
        """Words on a counter that loses photons to a dead time that was not told."""
        rate = held.on / held.on_s
        if self._live.dead_time.seconds or rate * USUAL_DEAD_S < SATURATED:
            return ""
        return (
            f"; at {rate:.3g} counts/s a counter with a dead time of {USUAL_DEAD_S * 1e9:.0f} ns "
            f"is blind {rate * USUAL_DEAD_S:.0%} of the time: give `dead_time`, or dim the light"
        )
