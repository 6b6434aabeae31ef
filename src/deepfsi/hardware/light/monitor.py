"""Light of a live run, scene by scene: the checks of recorded passes, made as each scene ends.

A scene is one pass: its frames stand between an all-ON and an all-OFF frame before its first look
and two after its last. The chance of a false alarm is that of a whole recording, shared by the
scenes that are planned.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deepfsi.hardware.light.checks import (
    CHECKS,
    Fault,
    PassLight,
    find_level_changes,
    find_restless_lamp,
)
from deepfsi.hardware.light.curves import (
    EXCESS,
    FALSE_ALARMS,
    Arrivals,
    Curves,
    excess_chance,
)
from deepfsi.hardware.light.flux import Background, allowed_ratio
from deepfsi.hardware.patterns.manifest import Manifest

NO_LIGHT = 0.01
"""Chance at most by which a scene without light is taken for one with light, before its looks."""


class LightMonitor:
    """Light of the scenes of a live run so far."""

    def __init__(self, manifest: Manifest, inputs: tuple[int, ...], scenes: int) -> None:
        count = manifest.detector_count
        self._manifest = manifest
        self._wired = [inputs[first : first + count] for first in range(0, len(inputs), count)]
        curves = len(self._wired) * (1 + count if count > 1 else 1)
        self._chance = FALSE_ALARMS / curves / CHECKS / scenes
        self._ends: list[Arrivals] = []  # of each scene, its all-ON and all-OFF frames
        self._lit: list[bool] = []
        self._sound: list[bool] = []
        self._backgrounds: list[Background] = []
        self._said: set[tuple[str, int | None]] = set()
        self.flux = 0.0
        self.since = 0
        self.dark = np.zeros(len(inputs))

    def begin(self, first: Arrivals) -> tuple[bool, tuple[Fault, ...]]:
        """Add the all-ON and the all-OFF frame that begin a scene."""
        # the two frames that end the scene are not counted yet
        unknown = replace(
            first,
            photons=0 * first.photons,
            variance=0 * first.variance,
            seconds=0 * first.seconds,
        )
        self._ends.append(Arrivals.join([first, unknown]))
        self._look_back()
        arm = self._history.every[0]
        dark = self._backgrounds[0]
        of_inputs = self._backgrounds[-len(self.dark) :]
        self.dark = np.array([one.rate[-1] for one in of_inputs])
        on, on_s = arm.together(arm.bright)
        chance = excess_chance(on[-1], on_s[-1], dark.photons[-1], dark.seconds[-1])
        lit = bool(chance <= NO_LIGHT)
        self._lit.append(lit)
        self._sound.append(lit)
        if not lit:
            return lit, ()
        light = PassLight(arm, dark, np.array(self._lit), np.array(self._sound))
        flux = light.measure_flux(self._manifest.brightness, self._chance)
        self.flux = float(flux.rate[-1])
        self.since = int(np.flatnonzero(flux.rate != flux.rate[-1]).max(initial=-1)) + 1
        changes = find_level_changes(flux)
        new = tuple(fault for fault in changes if (fault.kind, fault.scene) not in self._said)
        self._said |= {(fault.kind, fault.scene) for fault in new}
        return lit, new

    def end(self, lists: Sequence[Arrivals]) -> tuple[Fault, ...]:
        """Faults of the light of the scene that ends, from all lists of its frames."""
        scene = Arrivals.join(lists)
        last = len(self._ends) - 1
        frames = len(scene.frames)
        self._ends[-1] = scene.select([0, 1, frames - 2, frames - 1])
        self._look_back()
        faults: list[Fault] = []
        of_arms: set[str] = set()
        curves = Curves.of(Arrivals.stack([scene]), np.array([last]), self._wired)
        for index, curve in enumerate(curves.every):
            light = PassLight.of(curve, self._backgrounds[index].last, self._chance)
            of_curve = light.find_faults(self._chance)
            self._sound[-1] &= bool(light.sound[0])
            faults += [fault for fault in of_curve if fault.kind not in of_arms]
            if index == len(curves.arms) - 1:
                of_arms = {fault.kind for fault in faults}
        scenes = np.arange(last + 1)
        lit = np.array(self._lit)
        faults += find_restless_lamp(scenes, lit, np.array(self._sound))
        return tuple(faults)

    def contradicts(self, photons_s: float) -> bool:
        """True if a stated flux, counts/s, is further from the measured one than scenes explain."""
        from scipy.special import gammainc, gammaincc

        brightness = self._manifest.brightness
        if brightness is None:
            return False
        curve = self._history.every[0]
        used = np.flatnonzero(self._lit)
        used = used[used >= self.since]
        on, on_s = curve.together(curve.bright)
        counts = float(on[used].sum())
        seconds = float(on_s[used].sum())
        rate = float(self._backgrounds[0].rate[-1])
        ratio = allowed_ratio(brightness)(np.array(len(used)), np.array(np.inf)) * 1.0
        most, least = ((photons_s * factor + rate) * seconds for factor in (ratio, 1 / ratio))
        more = gammainc(counts / EXCESS, most / EXCESS)
        less = gammaincc(counts / EXCESS + 1, least / EXCESS)
        return bool(2 * min(more, less) <= self._chance)

    def _look_back(self) -> None:
        """Find the curves of the all-ON and all-OFF frames of all scenes, and their backgrounds."""
        ends = Arrivals.stack(self._ends)
        self._history = Curves.of(ends, np.arange(len(self._ends)), self._wired)
        self._backgrounds = [Background.of(c, self._chance) for c in self._history.every]
