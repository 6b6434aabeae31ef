"""Checks of the light of an acquisition against what it should be.

By the all-ON and all-OFF frames of each pass, and the masks' between them:

- ON is brighter than OFF, or there is no light.
- Both ON frames of a pass are equally bright, and both OFF frames: the lamp is steady.
- No mask sends more light than all mirrors ON.
- From pass to pass the light stays, as far as scenes are alike.

Tests are exact: all passes and checks together have the level `FALSE_ALARMS`. Changes below
`HARMLESS` are left alone, however certain. A recording is checked at once (`check_light`), a live
run scene by scene (`LightMonitor`): an all-ON and an all-OFF frame stand before the first look at a
scene and after the last one, and the planned scenes share the level.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal, Self

import numpy as np

from deepfsi.base.models import StrictModel
from deepfsi.camera.detectors import DetectorMap
from deepfsi.counting.flux import (
    CERTAIN_SIGMAS,
    FALSE_ALARMS,
    HARMLESS,
    HARMLESS_DARK,
    Arrivals,
    Background,
    Flux,
    LightCurve,
    change_p_value,
    excess_p_value,
    light_curves,
    rates_of,
)
from deepfsi.patterns.manifest import Brightness, Manifest

FaultKind = Literal[
    "dark",  # there is no light
    "unsteady",  # the light changed within the pass
    "brighter",  # a mask sends more light than all mirrors ON
    "flicker",  # the light is unsteady in many passes
    "level",  # the light is another from this scene on; its scenes have a budget of their own
    "blind",  # one of several detectors saw almost no light in all scenes together
    "gain",  # detectors share the light as in no scenes of the training
    "budget",  # less light than the design was trained for
    "repeated",  # counts are those of another exposure, bit for bit
    "unlike",  # the counts of a scene do not look like those of the training
    "view",  # live: counts of all scenes are as if the picture were mirrored, blurred or the like
    "late",  # other scenes are dark than are labelled so: the display lags
    "early",  # live: the class was given before the run was refused
]
"""Kinds of faults; a new check of the light may bring its own."""

SPOILING = (
    "dark", "brighter", "unsteady", "flicker", "budget", "gain", "repeated", "unlike", "view",
    "late",
)  # fmt: skip
"""Kinds of faults that leave a scene's counts without a meaning."""


class Fault(StrictModel):
    """Fault of a recording's light."""

    kind: FaultKind
    scene: int | None = None  # Which, from 0; None where no pass is meant
    frame: int | None = None  # Which, from 0; None where no one frame is meant
    detail: str  # What was seen and when

    def __str__(self) -> str:
        return self.words()

    def words(self, names: Sequence[str] = ()) -> str:
        """The fault in one line, with the name of its scene."""
        where: str = self.kind
        if self.scene is not None:
            where = ", ".join([f"{where} scene {self.scene}", *names[self.scene :][:1]])
        if self.frame is not None:
            where += f", frame {self.frame}"
        return f"{where}: {self.detail}"


@dataclass
class PassLight:
    """Light of passes under test, and the passes without a fault so far."""

    curve: LightCurve
    background: Background
    lit: np.ndarray  # (P,): bool; passes with light
    # (P,): bool; tested passes without a spoiling fault: tested are lit ones, and all passes of a
    # detector that sees a part of the device
    sound: np.ndarray

    @classmethod
    def of(cls, curve: LightCurve, background: Background, level: float) -> Self:
        """Light of passes that are not yet checked."""
        lit = _find_lit(curve, background, level)
        sound = np.ones_like(lit) if curve.sees_part else lit.copy()
        return cls(curve, background, lit, sound)

    def find_faults(self, level: float) -> list[Fault]:
        """Faults of passes, which are then not sound; a dark pass has no other fault."""
        tested = self.sound.copy()
        dark = list(self._find_dark())
        unlit = {fault.scene for fault in dark}
        further = [*self._find_brighter(level), *self._find_drift(level)]
        for fault in (*dark, *further):
            self.sound[self.curve.scenes == fault.scene] = False
        faults = dark + [fault for fault in further if fault.scene not in unlit]
        return faults + _find_restless_lamp(self.curve.scenes, tested, self.sound)

    def _find_dark(self) -> Iterator[Fault]:
        """Faults of dark passes; a detector that sees a part of the device may be dark."""
        curve = self.curve
        on, off = (rates_of(*curve.together(frames)) for frames in (curve.bright, curve.dark))
        for index in [] if curve.sees_part else np.flatnonzero(~self.lit).tolist():
            detail = (
                f"no light{curve.name}: {on[index]:.4g} counts/s with all light, {off[index]:.4g} "
                "with none"
            )
            yield Fault(kind="dark", scene=int(curve.scenes[index]), detail=detail)

    def _find_brighter(self, level: float) -> Iterator[Fault]:
        """Faults of passes in which a mask sends more light than all mirrors ON.

        Causes are stray light, or a lamp that changed. The fault names the brightest frame.
        """
        curve = self.curve
        photons = curve.photons
        seconds = curve.seconds
        on, on_s = curve.together(curve.bright)
        p_values = excess_p_value(photons, seconds, on[:, None], on_s[:, None], ratio=1 + HARMLESS)
        # all frames of all passes share the level
        brighter = p_values * photons.size <= level
        brighter[:, [*curve.bright, *curve.dark]] = False
        for index in np.flatnonzero(brighter.any(axis=1)).tolist():
            # rates relative to the all-ON frames; `max` guards against none of their photons
            scale = on_s[index] / max(on[index], 1)
            rates = rates_of(photons[index], seconds[index]) * scale
            frame = int(np.argmax(rates * brighter[index]))
            detail = (
                f"{curve.frames[frame]}{curve.name} is {rates[frame]:.3g} times as bright as all "
                f"light{_list_frames(brighter[index])}: stray light, or a lamp that went down for "
                "the all-ON frames, or a counter that is blind at this rate"
            )
            scene = int(curve.scenes[index])
            yield Fault(kind="brighter", scene=scene, frame=frame, detail=detail)

    def _find_drift(self, level: float) -> Iterator[Fault]:
        """Faults of passes whose two bright frames, or else two dark ones, differ."""
        curve = self.curve
        background = self.background
        light = np.maximum(rates_of(*curve.together(curve.bright)) - background.rate, 0.0)
        bright = _differ(curve, curve.bright, 1 + HARMLESS, level)
        # Without a single dark count the background is known to one count
        ratio = 1 + HARMLESS_DARK * light * background.seconds / (background.photons + 1)
        differ = bright | _differ(curve, curve.dark, ratio, level)
        for index in np.flatnonzero(differ).tolist():
            frames = curve.bright if bright[index] else curve.dark
            one, other = curve.photons[index, list(frames)].tolist()
            detail = (
                f"light{curve.name} changed within the pass: {one:.0f} photons in "
                f"{curve.frames[frames[0]]} at its start, {other:.0f} at its end"
            )
            yield Fault(kind="unsteady", scene=int(curve.scenes[index]), detail=detail)

    def measure_flux(self, brightness: Brightness | None, level: float) -> Flux:
        """Flux of passes, from the sound ones, or from all lit ones if none is sound."""
        used = self.sound if self.sound.any() else self.lit
        return Flux.of(self.curve, self.background, used=used, brightness=brightness, level=level)


def _find_lit(curve: LightCurve, background: Background, level: float) -> np.ndarray:
    """Passes (P,) whose bright frames, alone or with the masks', are brighter than the dark."""
    masks = [k for k in range(curve.photons.shape[1]) if k not in curve.dark]
    lit = np.zeros(len(curve.scenes), bool)
    for frames in (curve.bright, masks):
        photons, seconds = curve.together(frames)
        p_values = excess_p_value(photons, seconds, background.photons, background.seconds)
        # two tests of each pass share the level
        lit |= p_values * 2 * len(lit) <= level
    return lit


def _differ(
    curve: LightCurve, frames: tuple[int, int], ratio: np.ndarray | float, level: float
) -> np.ndarray:
    """Passes (P,) in which one of two frames is brighter by more than a ratio."""
    one, other = curve.photons[:, list(frames)].T
    one_s, other_s = curve.seconds[:, list(frames)].T
    p_values = change_p_value(one, one_s, other, other_s, ratio=ratio)
    return np.asarray(p_values * len(one) <= level)


def _find_level_changes(flux: Flux) -> Iterator[Fault]:
    """Faults of a light that changes at a scene, or rises or falls steadily."""
    if flux.trend is not None:
        detail = (
            f"all ON {'rises' if flux.trend > 1 else 'falls'} steadily, to {flux.trend:.3g} times "
            "its first brightness: each scene has a budget of its own"
        )
        yield Fault(kind="level", detail=detail)
    for before, after in pairwise(flux.levels):
        plural = after.last > after.first
        scenes = f"scenes {after.first} to {after.last} have" if plural else "this scene has"
        detail = (
            f"all ON is {after.rate / max(before.rate, 1e-300):.3g} times as bright as before, "
            f"and scenes do not differ so much: {scenes} another budget"
        )
        yield Fault(kind="level", scene=int(after.first), detail=detail)


CHECKS = 4
"""Checks of the light, which share `FALSE_ALARMS`."""


def _find_restless_lamp(scenes: np.ndarray, lit: np.ndarray, sound: np.ndarray) -> list[Fault]:
    """Fault of the whole recording if the light was wrong in many of its passes."""
    # One disturbance may reach into two passes that follow each other
    wrong = scenes[lit & ~sound]
    passes = np.count_nonzero(lit)
    # Share of passes in which the light must be unsteady for the others to be in doubt
    if len(wrong) < max(2, 0.1 * passes) or np.ptp(wrong) < 2:
        return []
    detail = (
        f"the light was unsteady in {len(wrong)} of {passes} passes, so it may have "
        "been in others: use a steady lamp, and keep stray light out"
    )
    return [Fault(kind="flicker", detail=detail)]


@dataclass(frozen=True)
class Light:
    """Light of the passes that were recorded."""

    flux: np.ndarray  # counts/s of each pass with all light, (P,)
    dark_rate: np.ndarray  # counts/s of each input without light, (P, inputs)
    faults: tuple[Fault, ...] = ()  # those of the whole recording first, then scene by scene
    lit: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))  # passes with light


def check_light(arrivals: Arrivals, manifest: Manifest, inputs: Sequence[int]) -> Light:
    """Check the light of a recording, all passes together; each scene has one pass."""
    count = manifest.detector_count
    scenes = np.arange(len(arrivals.photons))
    arm_inputs = [tuple(inputs[first : first + count]) for first in range(0, len(inputs), count)]
    curves = light_curves(arrivals, scenes, arm_inputs)
    level = FALSE_ALARMS / len(curves) / CHECKS
    lights = [PassLight.of(curve, Background.of(curve, level), level) for curve in curves]
    faults = _find_faults(lights, level)
    arms = lights[: len(arm_inputs)]
    of_inputs = lights[-len(inputs) :]
    flux = arms[0].measure_flux(manifest.brightness, level)
    faults += _find_level_changes(flux)
    if count > 1:
        faults += _find_blind_detectors(of_inputs)
        for column in range(0, len(of_inputs), count):
            faults += find_unequal_gains(of_inputs[column : column + count], manifest.detectors)
    faults.sort(key=lambda fault: (fault.scene is not None, fault.scene))
    rates = np.stack([light.background.rate for light in of_inputs], axis=1)
    lit = np.logical_and.reduce([light.lit for light in arms])
    return Light(flux.rate, rates, tuple(faults), lit)


def _find_faults(lights: Sequence[PassLight], level: float) -> list[Fault]:
    """Faults of arms, and of their detectors; a fault of the arm is not repeated for each."""
    faults = list[Fault]()
    of_arms = set[tuple[str, int | None]]()
    for light in lights:  # those of arms come first
        of_curve = light.find_faults(level)
        if light.curve.sees_part:
            of_curve = [fault for fault in of_curve if (fault.kind, fault.scene) not in of_arms]
        else:
            of_arms |= {(fault.kind, fault.scene) for fault in of_curve}
        faults += of_curve
    return faults


def _find_blind_detectors(detectors: Sequence[PassLight]) -> Iterator[Fault]:
    """Faults of detectors that see less than `HARMLESS` of their mean light, beyond doubt."""
    bright = [light.curve.together(light.curve.bright) for light in detectors]
    photons = np.array([float(counts.sum()) for counts, _ in bright])
    pairs = zip(detectors, bright, strict=True)
    dark = np.array([float(light.background.rate @ seconds) for light, (_, seconds) in pairs])
    lacks = dark + HARMLESS * (photons - dark).mean() - photons
    blind = lacks > CERTAIN_SIGMAS * np.sqrt(dark + photons + 1)
    for index in np.flatnonzero(blind).tolist():
        detail = (
            f"almost no light{detectors[index].curve.name} in all scenes together: their parts "
            "that this detector sees are dark, or it is not wired to that input"
        )
        yield Fault(kind="blind", detail=detail)


def find_unequal_gains(detectors: Sequence[PassLight], trained: DetectorMap | None) -> list[Fault]:
    """Fault of an arm whose detectors share the light as no mixture of classes does."""
    # The shares of the detectors, in the mean over scenes, are a mixture of the classes' shares,
    # whatever classes are shown. If no mixture explains them, detectors differ in efficiency
    if trained is None or trained.shares is None:
        return []
    bright = [light.curve.together(light.curve.bright) for light in detectors]
    photons, seconds = np.array(bright).swapaxes(0, 1)  # (D, P): those of equal relative noise
    rates = rates_of(photons, seconds) - np.array([light.background.rate for light in detectors])
    total = rates.sum()
    noise = np.sqrt(rates_of(photons + 1, seconds**2).sum(axis=1))
    if not total > noise.max():  # without light, shares are of noise
        return []
    share = rates.sum(axis=1) / total
    classes = np.array(trained.shares).T
    spread = np.array(trained.spread) / np.sqrt(rates.shape[1])
    allowed = HARMLESS * classes.max(axis=1) + CERTAIN_SIGMAS * np.hypot(spread, noise / total)
    departure, nearest = _nearest_mixture(share, classes, allowed)
    if departure <= 1:
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
    """Largest departure of shares (D,), over the allowed (D,), from the nearest mixture.

    `classes` (D, C) are mixed; the mixture (D,) is given, too.
    """
    from scipy.optimize import linprog

    # minimise t with |mixture − share| <= t · allowed, over weights that sum to 1
    slack = -np.concatenate([allowed, allowed])[:, None]
    last = np.eye(classes.shape[1] + 1)[-1]
    solution = linprog(
        last,
        A_ub=np.hstack([np.vstack([classes, -classes]), slack]),
        b_ub=np.concatenate([share, -share]),
        A_eq=[1 - last],
        b_eq=[1.0],
    )
    return float(solution.x[-1]), classes @ solution.x[:-1]


def _list_frames(which: np.ndarray) -> str:
    """Frames of a fault, if they are several, as an insertion."""
    frames = np.flatnonzero(which).tolist()
    if len(frames) < 2:
        return ""
    rest = f" and {len(frames) - 5} more" if len(frames) > 5 else ""
    return f" (frames {', '.join(map(str, frames[:5]))}{rest})"


def find_late(labelled: np.ndarray, light: np.ndarray) -> list[Fault]:
    """Fault of a run in which other scenes are dark, by their light (S,), than those (S,) to be."""
    if not labelled.any() or labelled.all():
        return []
    # all scenes have the ambient light; a tenth of the pictures' light is none
    black = light.min()
    dark = light <= black + 0.1 * (np.median(light[~labelled]) - black)
    if (dark == labelled).all():
        return []
    detail = (
        f"the dark scenes are {np.flatnonzero(dark).tolist()}, and the labelled ones "
        f"{np.flatnonzero(labelled).tolist()}: the display lags, or the lamp failed"
    )
    return [Fault(kind="late", detail=detail)]


NO_LIGHT = 0.01
"""Largest chance that a dark scene is taken for a lit one, before its looks."""


class LightMonitor:
    """Light of the scenes of a live run so far."""

    def __init__(self, manifest: Manifest, inputs: tuple[int, ...], scenes: int) -> None:
        count = manifest.detector_count
        self._manifest = manifest
        self._arm_inputs = [inputs[first : first + count] for first in range(0, len(inputs), count)]
        curves = len(self._arm_inputs) * (1 + count if count > 1 else 1)
        # scenes share the level from the start: their number is known before their light
        self._level = FALSE_ALARMS / curves / CHECKS / scenes
        self._sentinels: list[Arrivals] = []  # of each scene, its all-ON and all-OFF frames
        self._lit: list[bool] = []
        self._sound: list[bool] = []
        self._backgrounds: list[Background] = []
        self._reported: set[tuple[str, int | None]] = set()
        self._inputs = len(inputs)
        self.flux: float  # counts/s of the scene, once it is lit
        self.dark: np.ndarray  # counts/s of each input without light, (inputs,)
        self.on: np.ndarray  # counts/s of each scene's all-ON frames beyond the dark ones

    def begin(self, first: Arrivals, dark: bool = False) -> tuple[bool, tuple[Fault, ...]]:
        """Take the two frames before the looks at a scene: whether it is lit, and faults.

        A scene that is to be dark is not lit, whatever light it has.
        """
        # the two frames that end the scene are not counted yet
        unknown = replace(first, **{name: 0 * getattr(first, name) for name in Arrivals.ARRAYS})
        self._sentinels.append(Arrivals.join([first, unknown]))
        self._look_back()
        arm = self._history[0]
        background = self._backgrounds[0]
        of_inputs = self._backgrounds[-self._inputs :]
        self.dark = np.array([one.rate[-1] for one in of_inputs])
        on, on_s = arm.together(arm.bright)
        self.on = on / on_s - background.rate
        p_value = excess_p_value(on[-1], on_s[-1], background.photons[-1], background.seconds[-1])
        lit = bool(p_value <= NO_LIGHT) and not dark
        self._lit.append(lit)
        self._sound.append(lit)
        if not lit:
            return lit, ()
        light = PassLight(arm, background, np.array(self._lit), np.array(self._sound))
        flux = light.measure_flux(self._manifest.brightness, self._level)
        self.flux = float(flux.rate[-1])
        changes = _find_level_changes(flux)
        new = tuple(fault for fault in changes if (fault.kind, fault.scene) not in self._reported)
        self._reported |= {(fault.kind, fault.scene) for fault in new}
        return lit, new

    def end(self, lists: Sequence[Arrivals]) -> tuple[Fault, ...]:
        """Faults of the light of the scene that ends, from all its lists of frames."""
        scene = Arrivals.join(lists)
        last = len(self._sentinels) - 1
        self._sentinels[-1] = Arrivals.join([lists[0], lists[-1]])
        self._look_back()
        curves = light_curves(Arrivals.stack([scene]), np.array([last]), self._arm_inputs)
        lights = []
        for curve, so_far in zip(curves, self._backgrounds, strict=True):
            # dark counts pooled over the scenes so far are better known than this scene's
            dark = Background(so_far.photons[-1:], so_far.seconds[-1:])
            lights.append(PassLight.of(curve, dark, self._level))
        faults = _find_faults(lights, self._level)
        self._sound[-1] &= all(bool(light.sound[0]) for light in lights)
        scenes = np.arange(last + 1)
        faults += _find_restless_lamp(scenes, np.array(self._lit), np.array(self._sound))
        return tuple(faults)

    def _look_back(self) -> None:
        """Compute curves and backgrounds from the all-ON and all-OFF frames of all scenes."""
        ends = Arrivals.stack(self._sentinels)
        self._history = light_curves(ends, np.arange(len(self._sentinels)), self._arm_inputs)
        self._backgrounds = [Background.of(curve, self._level) for curve in self._history]
