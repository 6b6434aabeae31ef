"""Light of a live run, scene by scene: the laws of recorded passes, tested as each scene ends.

A scene is one pass: its frames stand between an all-ON and an all-OFF frame before its first look
and two after its last. The chance of a false alarm is that of a whole recording, shared by the
scenes that are planned.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammainc, gammaincc

from deepfsi.hardware.light.faults import Fault
from deepfsi.hardware.light.flicker import Periodogram
from deepfsi.hardware.light.flux import find_flux, light_curves, name_backgrounds, spread
from deepfsi.hardware.light.sentinels import (
    LAWS,
    Background,
    Checked,
    LightCurve,
    check_passes,
    find_background,
    find_restless_lamp,
    find_rhythm,
)
from deepfsi.hardware.light.tails import EXCESS, FALSE_ALARMS, excess_chance
from deepfsi.hardware.patterns.sequence import Frame, Manifest

NO_LIGHT = 0.01
"""Chance at most by which a scene without light is taken for one with light, before its looks."""


@dataclass(frozen=True)
class ShownFrames:
    """Light in frames that were shown one after another."""

    frames: tuple[Frame, ...]
    # (F, K, inputs): Photons that arrived in the parts of their gates, and the variance of their
    # noise
    photons: np.ndarray
    variance: np.ndarray
    seconds: np.ndarray  # (F, K): How long each part was open
    middles: np.ndarray  # (F, K): Times of the parts on the counter's clock, seconds

    @classmethod
    def join(cls, lists: "list[ShownFrames]") -> "ShownFrames":
        """Frames of lists that follow each other."""
        names = ("photons", "variance", "seconds", "middles")
        held = (np.concatenate([getattr(each, name) for each in lists]) for name in names)
        return cls(tuple(frame for each in lists for frame in each.frames), *held)


class LiveLight:
    """Light of the scenes of a live run so far."""

    def __init__(self, manifest: Manifest, inputs: tuple[int, ...], scenes: int) -> None:
        count = manifest.detector_count
        self._manifest = manifest
        self._wired = [inputs[first : first + count] for first in range(0, len(inputs), count)]
        self._arms = len(self._wired)
        self._curves = self._arms * (1 + count if count > 1 else 1)
        self._chance = FALSE_ALARMS / self._curves / LAWS / scenes
        self._ends: list[ShownFrames] = []  # of each scene, its all-ON and all-OFF frames
        self._lit: list[bool] = []
        self._sound: list[bool] = []
        self._periodograms = [Periodogram() for _ in range(self._curves)]
        self._backgrounds: list[Background] = []
        self._said: set[tuple[str, int | None]] = set()
        self.ambient = 0.0  # counts/s with all mirrors ON that are no scene's, beyond the dark ones
        self.flux = 0.0  # counts/s of the scenes' light with all mirrors ON
        self.since = 0  # scene from which on it is that
        self.dark = np.zeros(len(inputs))  # counts/s of each input without light

    def begin(self, first: ShownFrames) -> tuple[bool, tuple[Fault, ...]]:
        """Add the all-ON and the all-OFF frame that begin a scene: whether it has light, faults.

        Faults are changes of the lamp and the background that were not said before.
        """
        unknown = replace(
            first,
            photons=0 * first.photons,
            variance=0 * first.variance,
            seconds=0 * first.seconds,
        )
        self._ends.append(ShownFrames.join([first, unknown]))
        curves = self._find_backgrounds()
        self.dark = np.array([each.rate[-1] for each in self._backgrounds[-len(self.dark) :]])
        on, on_s = curves[0].together(curves[0].bright)
        dark = self._backgrounds[0]
        unlit = dark.photons[-1] + self.ambient * dark.seconds[-1]
        chance = excess_chance(on[-1], on_s[-1], unlit, dark.seconds[-1])
        lit = bool(chance <= NO_LIGHT)
        self._lit.append(lit)
        self._sound.append(lit)
        changes = [
            fault
            for curve, background in zip(curves[-len(self.dark) :],
                                         self._backgrounds[-len(self.dark) :], strict=True)
            for fault in name_backgrounds(curve, background)
        ]  # fmt: skip
        if lit:
            lit_so_far, sound = np.array(self._lit), np.array(self._sound)
            known = Checked(dark, lit_so_far, sound, ())
            flux, levels = find_flux(curves[0], known, self._manifest.brightness, self._chance)
            self.flux = float(flux[-1]) - self.ambient
            self.since = int(np.flatnonzero(flux != flux[-1]).max(initial=-1)) + 1
            changes += levels
        new = tuple(each for each in changes if (each.kind, each.scene) not in self._said)
        self._said |= {(each.kind, each.scene) for each in new}
        return lit, new

    def end(self, lists: list[ShownFrames]) -> tuple[Fault, ...]:
        """Faults of the light of the scene that ends, from all lists of its frames."""
        whole, last = ShownFrames.join(lists), len(self._ends) - 1
        places = [0, 1, len(whole.frames) - 2, len(whole.frames) - 1]
        self._ends[-1] = replace(
            whole,
            frames=tuple(whole.frames[place] for place in places),
            photons=whole.photons[places],
            variance=whole.variance[places],
            seconds=whole.seconds[places],
            middles=whole.middles[places],
        )
        history = self._find_backgrounds()
        faults: list[Fault] = []
        lost = np.empty(0, np.int64)
        named: set[str] = set()
        curves = self._curves_of([whole], np.array([last]))
        for place, curve in enumerate(curves):
            so_far, known = self._periodograms[place], self._backgrounds[place]
            so_far.add(curve.photons, curve.seconds, curve.middles - whole.middles[0, 0])
            rhythm = find_rhythm(replace(history[place], frames=whole.frames), so_far, self._chance)
            own = Background(known.photons[-1:], known.seconds[-1:], [slice(0, 1)])
            checked = check_passes(curve, own, rhythm, lost, self._chance)
            self._sound[-1] &= bool(checked.sound[0]) and not rhythm
            faults += [each for each in checked.faults if each.kind not in named]
            if place == self._arms - 1:
                named = {each.kind for each in faults}
        scenes, lit = np.arange(last + 1), np.array(self._lit)
        faults += find_restless_lamp(scenes, lit, np.array(self._sound), lost)
        return tuple(faults)

    def contradicts(self, photons_s: float) -> bool:
        """True if a stated flux, counts/s, is further from the measured one than scenes explain."""
        known = self._manifest.brightness
        if known is None:
            return False
        curve = self._curves_of(self._ends, np.arange(len(self._ends)))[0]
        used = np.flatnonzero(self._lit)
        used = used[used >= self.since]
        on, on_s = (each[used] for each in curve.together(curve.bright))
        found = float(on.sum()), float(on_s.sum())
        rate = float(self._backgrounds[0].rate[-1]) + self.ambient
        ratio = spread(known)(np.array(len(used)), np.array(np.inf)) * 1.0
        most, least = ((photons_s * each + rate) * found[1] for each in (ratio, 1 / ratio))
        more = gammainc(found[0] / EXCESS, most / EXCESS)
        less = gammaincc(found[0] / EXCESS + 1, least / EXCESS)
        return bool(2 * min(more, less) <= self._chance)

    def _find_backgrounds(self) -> list[LightCurve]:
        """Curves of the all-ON and all-OFF frames of all scenes, whose backgrounds are kept."""
        curves = self._curves_of(self._ends, np.arange(len(self._ends)))
        self._backgrounds = [find_background(curve, self._chance) for curve in curves]
        return curves

    def _curves_of(self, passes: list[ShownFrames], scenes: np.ndarray) -> list[LightCurve]:
        """Light of arms, then of detectors, in passes of the same frames."""
        photons, variance, seconds = (
            np.stack([getattr(each, name) for each in passes])
            for name in ("photons", "variance", "seconds")
        )
        last = passes[-1]
        arms, parts = light_curves(
            photons, variance, seconds, last.middles, scenes, last.frames, self._wired
        )
        return arms + parts
