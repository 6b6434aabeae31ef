"""Checks of the light of an acquisition against what it should be.

By the all-ON and all-OFF frames of each pass, and within its frames:

- ON is brighter than OFF, or there is no light.
- Both ON frames of a pass are equally bright, and both OFF frames: the scene is the same.
- Within a frame the light is steady: the mask is the same.
- No mask sends more light than all mirrors ON.
- Light has no rhythm, and does not vary fast in another way.
- From pass to pass the background stays, and the light as far as scenes are alike.

`CHECKS` has a class for each. Each is tested with exact chances, `FALSE_ALARMS` for all passes and
checks together. What is below `HARMLESS` is left alone, however certain it is. A recording is
checked as a whole (`check_light`), a live run scene by scene (`monitor`).
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import ClassVar, Literal, Self

import numpy as np

from deepfsi.base.errors import Message
from deepfsi.base.models.strict import StrictModel
from deepfsi.camera.detectors import DetectorMap
from deepfsi.hardware.light.curves import (
    CERTAIN_SIGMAS,
    EXCESS,
    FALSE_ALARMS,
    PARTS_OF_FRAME,
    Arrivals,
    Curves,
    LightCurve,
    change_chance,
    excess_chance,
)
from deepfsi.hardware.light.flux import HARMLESS, HARMLESS_DARK, Background, Flux
from deepfsi.hardware.patterns.manifest import Brightness, Manifest

FaultKind = Literal[
    "late", "dark", "unsteady", "brighter", "flicker", "level", "background", "blind", "budget",
    "gain", "unsure", "unlike", "view",
]  # fmt: skip
"""Kinds of faults; a new check of the light may bring its own."""


class Fault(StrictModel):
    """Fault of a recording's markers or of its light."""

    # Markers: `late`, all of them. Light: `dark`, there is none; `unsteady`, it changed within the
    # pass; `brighter`, a mask sends more than all mirrors ON; `flicker`, it has a rhythm, in all
    # passes; `level`, its brightness is another from this scene on; `background`, so is that of the
    # dark frames. Detectors: `blind`, one of several saw almost no light in all scenes together;
    # `gain`, they share the light as in no scenes of the training. `budget`: there is less light
    # than the design was trained for, or, in a live run, not the stated light. Live runs:
    # `unsure`, the counts of a scene do not look like those of the training; `unlike`, nor do those
    # of several scenes before; `view`, the counts of all scenes so far are as if the picture on
    # the device were mirrored, blurred or the like
    kind: FaultKind
    scene: int | None = None  # Which, from 0; None where no pass is meant
    frame: int | None = None  # Which, from 0; None where no one frame is meant
    detail: str  # What was seen and when

    def __str__(self) -> str:
        return self.words()

    def words(self, names: Sequence[str] = ()) -> str:
        """The fault in one line, with the name of its scene among those of all."""
        where = []
        if self.scene is not None:
            where += [f" scene {self.scene}", *(f" {name}" for name in names[self.scene :][:1])]
        if self.frame is not None:
            where.append(f" frame {self.frame}")
        start = f"{self.kind}{','.join(where)}"
        return Message("{start}: {detail}", start=start, detail=self.detail)

    def line(self, names: Sequence[str] = ()) -> str:
        """The fault in one line that also says if it is of markers or light; as of `words`."""
        return f"{'marker' if self.kind == 'late' else 'light'} {self.words(names)}"


@dataclass
class PassLight:
    """Light of passes under test, and what the checks have found so far."""

    curve: LightCurve
    ends: LightCurve  # all-ON and all-OFF frames of these passes, or of all passes so far
    rhythms: "Periodogram"  # of the same passes as `ends`
    background: Background
    lit: np.ndarray  # (P,): bool; passes with light
    # (P,): bool; passes that are tested (lit ones, or all of a detector that sees a part) in which
    # no check found a fault that spoils them
    sound: np.ndarray
    flux: Flux | None = None

    @classmethod
    def of(
        cls,
        curve: LightCurve,
        background: Background,
        chance: float,
        ends: LightCurve | None = None,
        rhythms: "Periodogram | None" = None,
    ) -> Self:
        """Light of passes; `ends` and `rhythms` are theirs unless given."""
        if rhythms is None:
            rhythms = Periodogram()
            rhythms.add(curve.photons, curve.seconds, curve.middles)
        lit = _find_lit(curve, background, chance)
        sound = np.ones_like(lit) if curve.sees_part else lit.copy()
        return cls(
            curve=curve,
            ends=curve if ends is None else ends,
            rhythms=rhythms,
            background=background,
            lit=lit,
            sound=sound,
        )

    @cached_property
    def bright_rate(self) -> np.ndarray:
        """Counts/s (P,) of the scene with all light, less the background."""
        on, on_s = self.curve.together(self.curve.bright)
        return np.maximum(on / np.where(on_s > 0, on_s, 1.0) - self.background.rate, 0.0)

    def measure_flux(self, brightness: Brightness | None, chance: float) -> np.ndarray:
        """Flux (P,), from passes whose light was steady if any was; it is kept with its changes."""
        used = self.sound if self.sound.any() else self.lit
        self.flux = Flux.of(
            self.curve, self.background, used=used, brightness=brightness, chance=chance
        )
        return self.flux.rate


def _find_lit(curve: LightCurve, background: Background, chance: float) -> np.ndarray:
    """Passes (P,) whose bright frames, alone or with the masks', are brighter than the dark."""
    masks = [k for k in range(curve.photons.shape[1]) if k not in curve.dark]
    lit = np.zeros(len(curve.scenes), bool)
    for frames in (curve.bright, masks):
        photons, seconds = curve.together(frames)
        chances = excess_chance(photons, seconds, background.photons, background.seconds)
        lit |= chances * 2 * len(lit) <= chance
    return lit


class _LightCheck(ABC):
    """One law of the light."""

    kind: ClassVar[FaultKind]  # kind of the faults that it finds
    spoils: ClassVar[bool] = True  # True if the counts of a pass that breaks it have no meaning
    of: ClassVar[Literal["all", "inputs", "arm"]] = "all"
    explained_by: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def find(self, light: PassLight, chance: float) -> Iterator[Fault]:
        """Faults that sound light shows with this chance at most, in all passes together."""


class _Rhythm(_LightCheck):
    """Light has no rhythm that a mask's frame does not average."""

    kind = "flicker"

    def find(self, light: PassLight, chance: float) -> Iterator[Fault]:
        """Fault of the whole recording, by the periodogram of all frames."""
        strongest = light.rhythms.strongest(chance)
        if strongest is None:
            return
        hertz, amplitude = strongest
        pictures = [frame.picture_us for frame in light.curve.frames if frame.role == "mask"]
        frame_s = float(np.mean(pictures)) * 1e-6
        averaged = min(1.0, 1 / (np.pi * hertz * frame_s))
        if amplitude * averaged >= HARMLESS:
            detail = (
                f"the light{light.curve.name} rises and falls by {amplitude:.0%} at {hertz:.4g} "
                "Hz: use a lamp that does not"
            )
            yield Fault(kind=self.kind, detail=detail)


class _FastChange(_LightCheck):
    """The all-ON frames of a pass do not scatter more than photons do, over all passes."""

    kind = "flicker"
    explained_by = ("flicker",)

    def find(self, light: PassLight, chance: float) -> Iterator[Fault]:
        """Fault of the whole recording, without the pass that scatters most."""
        from scipy.special import chdtrc

        curve = light.ends
        photons, seconds = curve.of(curve.bright)
        counted = (seconds > 0).all(axis=1) & (photons.sum(axis=1) > 0)
        photons = photons[counted].astype(np.float64)
        seconds = seconds[counted]
        if len(photons) < 3:
            return
        both = photons.sum(axis=1)
        share = seconds[:, 0] / seconds.sum(axis=1)
        spread = both * share * (1 - share)
        off = photons[:, 0] - both * share
        steps = off**2 / (EXCESS * spread + (HARMLESS * spread) ** 2)
        rest = float(steps.sum() - steps.max())
        if chdtrc(len(steps) - 1, rest) > chance:
            return
        excess = max(float((off**2 - EXCESS * spread).mean()), 0.0)
        size = np.sqrt(excess / float((spread**2).mean()))
        detail = (
            f"the all-{'ON' if curve.bright[0] == 0 else 'OFF'} frames of a pass{curve.name} "
            f"differ by {size:.0%} (rms over passes), more than their photons' noise: use a steady "
            "lamp"
        )
        yield Fault(kind=self.kind, detail=detail)


class _NoLight(_LightCheck):
    """ON is brighter than OFF. A detector that sees a part need not be lit."""

    kind = "dark"

    def find(self, light: PassLight, chance: float) -> Iterator[Fault]:
        """Faults of passes that are not lit."""
        curve = light.curve
        if curve.sees_part:
            return
        (on, on_s) = curve.together(curve.bright)
        (off, off_s) = curve.together(curve.dark)
        for index in np.flatnonzero(~light.lit).tolist():
            rate = float(on[index]) / max(float(on_s[index]), 1e-300)
            dark_rate = float(off[index]) / max(float(off_s[index]), 1e-300)
            detail = (
                f"no light{curve.name}: {rate:.4g} counts/s with all light, {dark_rate:.4g} with "
                "none"
            )
            yield Fault(kind=self.kind, scene=int(curve.scenes[index]), detail=detail)


class _BrighterMask(_LightCheck):
    """No mask's frame is brighter than those of its pass with all light."""

    kind = "brighter"
    explained_by = ("dark",)

    def find(self, light: PassLight, chance: float) -> Iterator[Fault]:
        """Faults of passes, each with its brightest frame."""
        curve = light.curve
        photons = curve.photons.sum(axis=2)
        seconds = curve.seconds.sum(axis=2)
        on, on_s = curve.together(curve.bright)
        chances = excess_chance(photons, seconds, on[:, None], on_s[:, None], ratio=1 + HARMLESS)
        brighter = chances * photons.size <= chance
        brighter[:, [*curve.bright, *curve.dark]] = False
        for index in np.flatnonzero(brighter.any(axis=1)).tolist():
            scale = on_s[index] / max(on[index], 1)
            rates = photons[index] / np.where(seconds[index] > 0, seconds[index], np.inf) * scale
            frame = int(np.argmax(np.where(brighter[index], rates, 0)))
            detail = (
                f"{curve.frames[frame]}{curve.name} is {rates[frame]:.3g} times as bright as all "
                f"light{_list_frames(brighter[index])}: stray light, or a lamp that went down for "
                "the all-ON frames, or a counter that is blind at this rate"
            )
            scene = int(curve.scenes[index])
            yield Fault(kind=self.kind, scene=scene, frame=frame, detail=detail)


class _UnsteadyFrame(_LightCheck):
    """Within a frame the light is steady: no part of it stands out from the others."""

    kind = "unsteady"
    explained_by = ("dark", "flicker")

    LOOKED_AT_SIGMAS = 3.0  # below which a part of a frame is not worth an exact test

    # Parts of a frame that are compared with its others, each way, (ways, PARTS_OF_FRAME)
    SPLITS = np.array(
        [
            (np.arange(PARTS_OF_FRAME) >= first) & (np.arange(PARTS_OF_FRAME) < stop)
            for first in range(PARTS_OF_FRAME)
            for stop in range(first + 1, PARTS_OF_FRAME + 1)
            if stop - first < PARTS_OF_FRAME and (first == 0 or stop < PARTS_OF_FRAME)
        ],
        float,
    )

    def find(self, light: PassLight, chance: float) -> Iterator[Fault]:
        """Faults of passes, each with its least steady frame."""
        curve = light.curve
        restless = self._find_restless(light, chance)
        for index in np.flatnonzero(restless.any(axis=1)).tolist():
            photons = curve.photons[index]
            off = photons - photons.mean(axis=1, keepdims=True)
            strength = (off**2).sum(axis=1) / np.maximum(photons.sum(axis=1), 1)
            frame = int(np.argmax(np.where(restless[index], strength, -1)))
            counts = ", ".join(f"{count:.0f}" for count in photons[frame].tolist())
            detail = (
                f"light{curve.name} changed within {curve.frames[frame]}: {counts} photons in its "
                f"parts{_list_frames(restless[index])}"
            )
            scene = int(curve.scenes[index])
            yield Fault(kind=self.kind, scene=scene, frame=frame, detail=detail)

    def _find_restless(self, light: PassLight, chance: float) -> np.ndarray:
        """Frames (P, F) in which the light is not steady."""
        curve = light.curve
        total = curve.photons.sum(axis=2)
        total_s = curve.seconds.sum(axis=2)
        restless = np.zeros(total.shape, bool)
        if curve.photons.shape[2] < PARTS_OF_FRAME:
            return restless  # frames were counted whole
        rate = (total + 1) / np.where(total_s > 0, total_s, np.inf)
        harmless = HARMLESS_DARK * light.bright_rate[:, None] / np.maximum(rate, 1e-300)
        ratio = np.where(total_s > 0, 1 + np.maximum(HARMLESS, harmless), 1.0)
        tests = len(self.SPLITS) * total.size
        for split in self.SPLITS:
            some = curve.photons @ split
            some_s = curve.seconds @ split
            share = some_s / np.where(total_s > 0, total_s, 1.0)
            noise = np.sqrt(np.maximum(total * share * (1 - share), 1e-300))
            far = np.abs(some - total * share) > self.LOOKED_AT_SIGMAS * noise
            inside = some[far], some_s[far]
            outside = (total - some)[far], (total_s - some_s)[far]
            restless[far] |= change_chance(*inside, *outside, ratio=ratio[far]) * tests <= chance
        return restless


class _Drift(_LightCheck):
    """Both ON frames of a pass are equally bright, and both OFF frames."""

    kind = "unsteady"
    explained_by = ("dark", "flicker", "unsteady")

    def find(self, light: PassLight, chance: float) -> Iterator[Fault]:
        """Faults of passes whose two bright frames, or else two dark ones, differ."""
        curve = light.curve
        background = light.background
        spent = np.where(background.seconds > 0, background.seconds, 1.0)
        floor = (background.photons + 1) / spent
        bright = self._differ(curve, curve.bright, 1 + HARMLESS, chance)
        ratio = 1 + HARMLESS_DARK * light.bright_rate / floor
        differ = bright | self._differ(curve, curve.dark, ratio, chance)
        for index in np.flatnonzero(differ).tolist():
            frames = curve.bright if bright[index] else curve.dark
            one, other = (float(curve.photons[index, frame].sum()) for frame in frames)
            detail = (
                f"light{curve.name} changed within the pass: {one:.0f} photons in "
                f"{curve.frames[frames[0]]} at its start, {other:.0f} at its end"
            )
            yield Fault(kind=self.kind, scene=int(curve.scenes[index]), detail=detail)

    @staticmethod
    def _differ(
        curve: LightCurve, frames: tuple[int, int], ratio: np.ndarray | float, chance: float
    ) -> np.ndarray:
        """Passes (P,) in which one of two frames is brighter than the other, by more than that."""
        photons, seconds = curve.of(frames)
        (one, other) = photons.T
        (one_s, other_s) = seconds.T
        chances = change_chance(one, one_s, other, other_s, ratio=ratio)
        return np.asarray(chances * len(photons) <= chance)


class _BackgroundChange(_LightCheck):
    """The background of an input stays. Counts are rid of each scene's own."""

    kind = "background"
    spoils = False
    of = "inputs"

    def find(self, light: PassLight, chance: float) -> Iterator[Fault]:
        """Faults of the scenes from which on it is another."""
        background = light.background
        curve = light.curve
        for segment in background.segments[1:]:
            before, after = background.rate[[segment.start - 1, segment.start]]
            detail = (
                f"dark frames{curve.name} have {after:.4g} counts/s, and {before:.4g} before: the "
                "background is that of scenes from here on"
            )
            scene = int(curve.scenes[segment.start])
            yield Fault(kind=self.kind, scene=scene, detail=detail)


class _LevelChange(_LightCheck):
    """The light is as bright for all scenes, as far as scenes are alike."""

    kind = "level"
    spoils = False
    of = "arm"

    def find(self, light: PassLight, chance: float) -> Iterator[Fault]:
        """Faults of the scenes from which on it is another, or of a steady rise or fall."""
        if light.flux is None:
            return
        trend = light.flux.trend
        if trend is not None:
            detail = (
                f"all ON {'rises' if trend > 1 else 'falls'} steadily, to {trend:.3g} times its "
                "first brightness: each scene has a budget of its own"
            )
            yield Fault(kind=self.kind, detail=detail)
        for before, after in pairwise(light.flux.levels):
            several = after.last > after.first
            some = f"scenes {after.first} to {after.last}" if several else "this scene"
            detail = (
                f"all ON is {after.rate / max(before.rate, 1e-300):.3g} times as bright as before, "
                f"and scenes do not differ so much: {some} have a budget of their own"
            )
            yield Fault(kind=self.kind, scene=int(after.first), detail=detail)


CHECKS: tuple[_LightCheck, ...] = (
    _Rhythm(),
    _FastChange(),
    _NoLight(),
    _BrighterMask(),
    _UnsteadyFrame(),
    _Drift(),
    _BackgroundChange(),
    _LevelChange(),
)
"""All checks of the light, in the order in which they are tested; `FALSE_ALARMS` is theirs."""

SPOILING = (
    *dict.fromkeys(check.kind for check in CHECKS if check.spoils),
    *("budget", "gain", "unsure", "unlike", "view"),
)
"""Kinds of faults that leave a scene's counts without a meaning."""


def run_checks(light: PassLight, of: Literal["all", "inputs", "arm"], chance: float) -> list[Fault]:
    """Faults of a curve by the checks on such curves; passes that they spoil are no more sound."""
    faults: list[Fault] = []
    named: set[tuple[str, int | None]] = set()
    for check in CHECKS:
        if check.of != of:
            continue
        for fault in check.find(light, chance):
            if check.spoils and fault.scene is not None:
                light.sound[light.curve.scenes == fault.scene] = False
            causes = {(kind, scene) for kind in check.explained_by for scene in (None, fault.scene)}
            if not causes & named:
                faults.append(fault)
                named.add((fault.kind, fault.scene))
    return faults


RESTLESS_SHARE = 0.1
"""Share of passes in which the light must be unsteady for the others to be in doubt."""


def find_restless_lamp(scenes: np.ndarray, lit: np.ndarray, sound: np.ndarray) -> list[Fault]:
    """Fault of the whole recording if the light was wrong in many of its passes."""
    # One disturbance may reach into two passes that follow each other
    wrong = scenes[lit & ~sound]
    passes = np.count_nonzero(lit)
    if len(wrong) < max(2, RESTLESS_SHARE * passes) or np.ptp(wrong) < 2:
        return []
    detail = (
        f"the light was unsteady in {len(wrong)} of {passes} passes, so it may have "
        "been in others: use a steady lamp, and keep stray light out"
    )
    return [Fault(kind="flicker", detail=detail)]


@dataclass(frozen=True)
class Light:
    """Light of the passes that were recorded."""

    flux: np.ndarray
    dark_rate: np.ndarray  # counts/s of each input without light
    lit: np.ndarray  # passes with light
    faults: tuple[Fault, ...]  # those of the whole recording first, then scene by scene


def check_light(
    arrivals: Arrivals,
    manifest: Manifest,
    inputs: Sequence[int],
    *,
    scenes: np.ndarray,
) -> Light:
    """Check the light of a recording, all passes together."""
    count = manifest.detector_count
    wired = [tuple(inputs[first : first + count]) for first in range(0, len(inputs), count)]
    curves = Curves.of(arrivals, scenes, wired)
    chance = FALSE_ALARMS / len(curves.every) / len(CHECKS)
    lights = []
    faults = list[Fault]()
    of_arms = set[tuple[str, int | None]]()
    for curve in curves.every:
        light = PassLight.of(curve, Background.of(curve, chance), chance)
        tested = light.sound.copy()
        of_curve = run_checks(light, "all", chance)
        if not any(fault.kind == "flicker" for fault in of_curve):
            of_curve += find_restless_lamp(scenes, tested, light.sound)
        if curve.sees_part:  # what all detectors of an arm show together is said once
            of_curve = [fault for fault in of_curve if (fault.kind, fault.scene) not in of_arms]
        else:
            of_arms |= {(fault.kind, fault.scene) for fault in of_curve}
        faults += of_curve
        lights.append(light)
    arms = lights[: len(curves.arms)]
    of_inputs = lights[-len(curves.inputs) :]
    for light in of_inputs:
        faults += run_checks(light, "inputs", chance)
    first = arms[0]
    flux = first.measure_flux(manifest.brightness, chance)
    faults += run_checks(first, "arm", chance)
    if curves.detectors:
        faults += _find_blind_detectors(of_inputs)
        for column in range(0, len(of_inputs), count):
            faults += find_unequal_gains(of_inputs[column : column + count], manifest.detectors)
    faults.sort(key=lambda fault: (fault.scene is not None, fault.scene))
    rates = np.stack([light.background.rate for light in of_inputs], axis=1)
    lit = np.logical_and.reduce([light.lit for light in arms])
    return Light(flux, rates, lit, tuple(faults))


def find_lateness(photons: np.ndarray, seconds: np.ndarray, room_s: float) -> tuple[Fault, ...]:
    """Name markers that all come late: light of the first mask is in the frame before it."""
    guard, dark, light = photons
    guard_s, dark_s, light_s = seconds
    used = (dark_s > 0) & (light_s > 0)
    if np.count_nonzero(used) > 1:  # a burst of stray light in one of them is another fault
        used[np.argmax(np.where(used, guard, -1))] = False
    share = guard_s[used] / dark_s[used]
    excess = float((guard[used] - dark[used] * share).sum())
    noise = float(np.sqrt((dark[used] * share * (1 + share)).sum() + 1))
    rate = float((light[used] / light_s[used] - dark[used] / dark_s[used]).sum())
    if excess <= CERTAIN_SIGMAS * noise or rate <= 0:
        return ()
    late = excess / rate
    detail = (
        f"all markers, by {late * 1e6:.1f} µs: the light of each frame begins before its marker"
    )
    if room_s < late:
        detail += (
            f", and gates end {max(room_s, 0) * 1e6:.1f} µs before the next marker: mend the "
            "trigger, or count a shorter --exposure"
        )
    return (Fault(kind="late", detail=detail),)


def _find_blind_detectors(detectors: Sequence[PassLight]) -> list[Fault]:
    """Detectors that certainly see less than `HARMLESS` of the light that they see in the mean."""
    bright = [light.curve.together(light.curve.bright) for light in detectors]
    photons = np.array([float(counts.sum()) for counts, _ in bright])
    pairs = zip(detectors, bright, strict=True)
    dark = np.array([float(light.background.rate @ seconds) for light, (_, seconds) in pairs])
    wanted = HARMLESS * max(float((photons - dark).sum()), 0.0) / max(len(detectors), 1)
    lacks = dark + wanted - photons
    blind = lacks > CERTAIN_SIGMAS * np.sqrt(dark + photons + 1)
    faults = []
    for index in np.flatnonzero(blind).tolist():
        detail = (
            f"almost no light{detectors[index].curve.name} in all scenes together: their parts "
            "that this detector sees are dark, or it is not wired to that input"
        )
        faults.append(Fault(kind="blind", detail=detail))
    return faults


def find_unequal_gains(detectors: Sequence[PassLight], trained: DetectorMap | None) -> list[Fault]:
    """Fault of an arm's detectors that share the light of all scenes as no classes do, if any."""
    # In the mean over scenes each detector's share of the light lies among those of the classes,
    # whatever classes are shown. Where no mixture of classes explains the shares, detectors differ
    # in efficiency
    if trained is None or trained.shares is None:
        return []
    bright = [light.curve.together(light.curve.bright) for light in detectors]
    photons, seconds = np.array(bright).swapaxes(0, 1)  # (D, P): those of equal relative noise
    seconds = np.where(seconds > 0, seconds, np.inf)
    rates = photons / seconds - np.array([light.background.rate for light in detectors])
    every = rates.sum()
    if not every > 0:
        return []
    share = rates.sum(axis=1) / every
    classes = np.array(trained.shares).T
    spread = np.array(trained.spread) / np.sqrt(rates.shape[1])
    noise = np.sqrt(((photons + 1) / seconds**2).sum(axis=1)) / every
    allowed = HARMLESS * classes.max(axis=1) + CERTAIN_SIGMAS * np.hypot(spread, noise)
    off, nearest = _nearest_mixture(share, classes, allowed)
    if off <= 1:
        return []
    ratio = share / np.maximum(nearest, 1e-300)
    worst = int(np.abs(np.log(np.maximum(ratio, 1e-300))).argmax())
    detail = (
        f"{ratio[worst]:.2g} times the light{detectors[worst].curve.name} that scenes of the "
        "training give it: record uniform white with these patterns, and count with --flat"
    )
    return [Fault(kind="gain", detail=detail)]


def _nearest_mixture(
    share: np.ndarray, classes: np.ndarray, allowed: np.ndarray
) -> tuple[float, np.ndarray]:
    """Largest departure from the nearest mixture of classes (D, C), over the allowed (D,)."""
    from scipy.optimize import linprog

    count = classes.shape[1]
    slack = -np.concatenate([allowed, allowed])[:, None]
    solution = linprog(
        np.append(np.zeros(count), 1.0),
        A_ub=np.hstack([np.vstack([classes, -classes]), slack]),
        b_ub=np.concatenate([share, -share]),
        A_eq=np.append(np.ones(count), 0.0)[None],
        b_eq=[1.0],
    )
    return float(solution.x[-1]), classes @ solution.x[:-1]


NAMED_FRAMES = 5
"""Frames that a fault lists at most."""


def _list_frames(which: np.ndarray) -> str:
    """Frames of a fault, if they are several, as an insertion."""
    frames = np.flatnonzero(which).tolist()
    if len(frames) < 2:
        return ""
    more = f" and {len(frames) - NAMED_FRAMES} more" if len(frames) > NAMED_FRAMES else ""
    return f" (frames {', '.join(map(str, frames[:NAMED_FRAMES]))}{more})"


@dataclass(frozen=True)
class _Block:
    """Frames of passes that follow each other, within which a rhythm keeps its phase."""

    middles: np.ndarray  # (f, K): Times of the parts of each frame, seconds
    lacks: np.ndarray  # (P, f, K): Photons of each part less its share of the frame's
    photons: np.ndarray  # (P, f)


class Periodogram:
    """Evidence for rhythms, of all passes so far: a periodogram of photons within frames.

    A mask's light is steady while its frame is shown, whatever the scene. So what the parts of a
    frame lack or have beyond their share is noise, unless the light itself has a rhythm. Blocks of
    some tenths of a second are compared with each frequency by themselves, as no lamp keeps its
    phase for long, and their evidence is added.
    """

    BLOCK_S = 0.5  # over which a rhythm keeps its phase at least
    MOST_HZ = 5e3  # fastest rhythm that is looked for
    MOST_FREQUENCIES = 4096
    LEAST_PHOTONS = 100  # that a block must hold to say something
    AT_ONCE = 2**22  # sines that are held in memory

    def __init__(self) -> None:
        self._hertz = np.empty(0)  # those of the first passes
        self._evidence = np.zeros((4, 0))  # as of `_gather`

    def add(self, photons: np.ndarray, seconds: np.ndarray, middles: np.ndarray) -> None:
        """Add passes whose frames have the same times."""
        total_s = np.maximum(seconds.sum(axis=2, keepdims=True), 1e-300)
        total = photons.sum(axis=2)
        lacks = photons - total[..., None] * seconds / total_s
        number = np.floor((middles[:, 0] - middles[0, 0]) / self.BLOCK_S).astype(int)
        cuts = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]
        blocks = [_Block(middles[a:b], lacks[:, a:b], total[:, a:b]) for a, b in pairwise(cuts)]
        if not len(self._hertz):
            self._hertz = self._frequencies(blocks)
            self._evidence = np.zeros((4, len(self._hertz)))
        step = max(1, self.AT_ONCE // middles.size)
        for a in range(0, len(self._hertz), step):
            more = self._gather(blocks, self._hertz[a : a + step])
            so_far = self._evidence[:, a : a + step]
            so_far[1] = np.maximum(so_far[1], more[1])
            so_far[[0, 2, 3]] += more[[0, 2, 3]]

    def strongest(self, chance: float) -> tuple[float, float] | None:
        """Strongest rhythm beyond chance, if any: Hz, and its amplitude as a share of the mean."""
        # The pass that shows most of it is left out where there are three or more: what one pass
        # alone shows is no rhythm
        from scipy.special import chdtrc

        if not len(self._hertz):
            return None
        total, strongest, count, size = self._evidence
        many = count >= 3
        rest = np.where(many, total - strongest, total)
        chances = chdtrc(np.maximum(2 * (count - many), 1), rest) * len(self._hertz)
        best = int(np.argmin(chances))
        if not (count[best] and chances[best] <= chance):
            return None
        best = int(np.argmax(np.where(chances <= chance, rest, 0)))
        amplitude = np.sqrt(EXCESS * max(total[best] - 2 * count[best], 0) / size[best])
        return float(self._hertz[best]), float(amplitude)

    def _frequencies(self, blocks: list[_Block]) -> np.ndarray:
        """Frequencies in Hz of which the longest block has a whole period, and parts can see."""
        if blocks[0].middles.shape[1] < 2:
            return np.empty(0)
        longest = max(float(np.ptp(block.middles)) for block in blocks)
        part_s = float(np.median(np.diff(blocks[0].middles, axis=1)))
        if longest <= 0 or part_s <= 0:
            return np.empty(0)
        top = min(0.5 / part_s, self.MOST_HZ)
        first = 1 / longest
        step = 0.5 / longest
        number = int(min(max((top - first) / step + 1, 0), self.MOST_FREQUENCIES))
        return first + step * np.arange(number)

    def _gather(self, blocks: list[_Block], hertz: np.ndarray) -> np.ndarray:
        """Evidence for each frequency: sum, largest, number of blocks, their sensitivity (4, M)."""
        out = np.zeros((4, len(hertz)))
        for block in blocks:
            phase = 2 * np.pi * block.middles[..., None] * hertz
            cosine = np.cos(phase)
            sine = np.sin(phase)
            centred = [wave - wave.mean(axis=1, keepdims=True) for wave in (cosine, sine)]
            number = block.photons.astype(np.float64)
            lacks = block.lacks.reshape(len(number), -1)
            u, v = (lacks @ wave.reshape(-1, len(hertz)) for wave in (cosine, sine))
            a = number @ (centred[0] ** 2).mean(axis=1)
            b = number @ (centred[1] ** 2).mean(axis=1)
            c = number @ (centred[0] * centred[1]).mean(axis=1)
            determinant = a * b - c * c
            sees = (number.sum(axis=1) >= self.LEAST_PHOTONS)[:, None] & (
                determinant > 1e-3 * (a + b) ** 2 / 4
            )
            safe = np.where(sees, determinant, 1.0)
            evidence = np.where(sees, (u * u * b - 2 * u * v * c + v * v * a) / safe / EXCESS, 0.0)
            out[0] += evidence.sum(axis=0)
            out[1] = np.maximum(out[1], evidence.max(axis=0))
            out[2] += sees.sum(axis=0)
            out[3] += np.where(sees, (a + b) / 2, 0.0).sum(axis=0)
        return out
