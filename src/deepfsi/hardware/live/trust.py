"""Trust in a scene of a live run: its budget, and its counts against those of the training."""

from collections import deque

from scipy.special import bdtrc

from deepfsi.camera import TOO_DIM
from deepfsi.designfile import REFUSED, UNSURE
from deepfsi.hardware.counting import Acquisition
from deepfsi.hardware.light import Fault, LightMonitor
from deepfsi.hardware.live.looks import AllOn, Likeness

LOOKED_BACK = 20
"""Scenes up to the present one among which the unsure ones are counted."""

USUAL_DEAD_S = 3e-8
"""Dead time that a counter with its detector may well have, seconds."""

SATURATED = 0.05
"""Share of the photons lost to it from which on saturation is named."""


class Trust:
    """Tests of scene after scene."""

    def __init__(self, trained: float | None, acquisition: Acquisition) -> None:
        assert acquisition.live is not None
        self._trained, self._exposure_s = trained, acquisition.exposure_s
        self._live, self._scenes = acquisition.live, len(acquisition.scenes)
        self._unsure: deque[bool] = deque(maxlen=LOOKED_BACK)

    def find_faults(
        self,
        scene: int,
        likeness: Likeness | None,
        on: AllOn,
        light: LightMonitor,
        photons: float,
        measured: float,
    ) -> tuple[Fault, ...]:
        """Faults of a scene, of its budget and the measured one, counts of an exposure."""
        faults: list[Fault] = []
        stated, trained = self._live.photons, self._trained
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
        return (*faults, *self._unlikely(scene, likeness, self._saturation(on)))

    def _unlikely(self, scene: int, found: Likeness | None, hint: str) -> list[Fault]:
        """Faults of counts that do not look like those of the training."""
        if found is None:
            return []
        self._unsure.append(found.unsure)
        faults, seen = [], len(self._unsure)
        if found.unsure:
            detail = (
                f"its counts do not look like what this design was trained for (p = "
                f"{found.chance:.1g}; {found.detail}){hint}"
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

    def _saturation(self, on: AllOn) -> str:
        """Words on a counter that loses photons to a dead time that was not told."""
        rate = on.counts / on.seconds
        if self._live.dead_time.seconds or rate * USUAL_DEAD_S < SATURATED:
            return ""
        return (
            f"; at {rate:.3g} counts/s a counter with a dead time of {USUAL_DEAD_S * 1e9:.0f} ns "
            f"is blind {rate * USUAL_DEAD_S:.0%} of the time: give `dead_time`, or dim the light"
        )
