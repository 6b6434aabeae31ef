"""Light of an acquisition: its faults, and the flux and background of each scene.

The flux of a scene is the mean over the passes between two changes of the lamp, not its own: scenes
differ in brightness, and a dim one is to stay dim. What a scene's brightness may be is known from
the training scenes (`Brightness`). Where the all-ON rates change by more, the light did.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from deepfsi.hardware.counting.acquisition import name_inputs
from deepfsi.hardware.counting.alignment import CERTAIN_SIGMAS
from deepfsi.hardware.light.faults import Fault
from deepfsi.hardware.light.gains import find_gains
from deepfsi.hardware.light.levels import Allowed, Row, find_parts
from deepfsi.hardware.light.sentinels import (
    HARMLESS,
    LAWS,
    Background,
    Checked,
    LightCurve,
    check_light,
)
from deepfsi.hardware.light.tails import FALSE_ALARMS
from deepfsi.hardware.patterns.sequence import Brightness, Frame, Manifest

SPREAD_SIGMAS = 5.0
"""Standard deviations by which scenes of one class may differ from their mean."""

LEAST_FOR_DECAY = 5
"""Passes that a steady rise or fall is fitted to at least."""

RANGE_SLACK = 1.25
"""Range of brightness that new scenes may fill, as a multiple of the training scenes' (in log)."""


@dataclass(frozen=True)
class Light:
    """Light of the passes that were recorded."""

    # (P,): Counts/s of the scenes' light with all mirrors ON, mean over the passes that agree with
    # each
    flux: np.ndarray
    dark_rate: np.ndarray  # (P, inputs): Counts/s of each input without light
    lit: np.ndarray  # (P,): bool; passes with light
    faults: tuple[Fault, ...]


def find_light(
    photons: np.ndarray,
    variance: np.ndarray,
    seconds: np.ndarray,
    middles: np.ndarray,
    scenes: np.ndarray,
    inputs: tuple[int, ...],
    manifest: Manifest,
    lost: np.ndarray,
) -> Light:
    """Light of an acquisition, from the parts of frames of the passes that were recorded."""
    # photons, variance (P, F, K, inputs); seconds (P, F, K); middles (F, K); scenes (P,)
    count = manifest.detector_count
    wired = [inputs[first : first + count] for first in range(0, len(inputs), count)]
    arms, detectors = light_curves(
        photons, variance, seconds, middles, scenes, manifest.frames, wired
    )
    chance = FALSE_ALARMS / (len(arms) + len(detectors))
    checked = [check_light(curve, lost, chance) for curve in arms]
    alone = [check_light(curve, lost, chance) for curve in detectors]
    faults = [fault for each in checked for fault in each.faults]
    named = {(fault.kind, fault.scene) for fault in faults}
    faults += [each for one in alone for each in one.faults if (each.kind, each.scene) not in named]
    flux, changes = find_flux(arms[0], checked[0], manifest.brightness, chance / LAWS)
    for curve, each in zip(detectors or arms, alone or checked, strict=True):
        faults += name_backgrounds(curve, each.background)
    faults += changes
    backgrounds = [each.background for each in alone]
    faults += _find_blind(detectors, backgrounds)
    for first in range(0, len(alone), count):
        arm = slice(first, first + count)
        faults += find_gains(detectors[arm], backgrounds[arm], manifest.detectors)
    faults.sort(key=lambda fault: (fault.scene is not None, fault.scene))
    rates = np.stack([each.background.rate for each in alone or checked], axis=1)
    lit = np.logical_and.reduce([each.lit for each in checked])
    return Light(flux, rates, lit, tuple(faults))


def light_curves(
    photons: np.ndarray,
    variance: np.ndarray,
    seconds: np.ndarray,
    middles: np.ndarray,
    scenes: np.ndarray,
    shown: tuple[Frame, ...],
    wired: list[tuple[int, ...]],
) -> tuple[list[LightCurve], list[LightCurve]]:
    """Light of each arm's detectors together, and of each detector where an arm has several."""
    frames = len(middles)
    on, off = (0, frames - 2), (1, frames - 1)
    arms, detectors = [], []

    def poisson(columns: slice) -> tuple[np.ndarray, np.ndarray]:
        held = photons[..., columns].sum(axis=-1)
        noise = variance[..., columns].sum(axis=(-2, -1))
        share = np.where(noise > 0, held.sum(axis=-1) / np.where(noise > 0, noise, 1), 1)[..., None]
        return held * share, seconds * share

    for arm, inputs in enumerate(wired):
        first = arm * len(inputs)
        together = LightCurve(
            *poisson(slice(first, first + len(inputs))),
            middles,
            scenes,
            *((on, off) if arm == 0 else (off, on)),
            shown,
            f" on input {name_inputs(inputs)}" if len(wired) > 1 else "",
        )
        arms.append(together)
        for column, each in enumerate(inputs if len(inputs) > 1 else (), first):
            own, open_s = poisson(slice(column, column + 1))
            name = f" on input {each + 1}"
            detectors.append(replace(together, photons=own, seconds=open_s, name=name, part=True))
    return arms, detectors


def find_flux(
    curve: LightCurve, checked: Checked, brightness: Brightness | None, chance: float
) -> tuple[np.ndarray, list[Fault]]:
    """Flux (P,) and the faults of its changes, from passes whose light was steady if any was."""
    used = checked.sound if checked.sound.any() else checked.lit
    if not used.any():
        return np.zeros(len(used)), []
    on, on_s = curve.together(curve.bright)
    used = used & (on_s > 0)
    rate = checked.background.rate
    error = rate**2 / np.maximum(checked.background.photons, 1)
    counts = on - rate * on_s
    row = Row(counts[used], on[used] + error[used] * on_s[used] ** 2, on_s[used])
    parts, places = [slice(0, int(used.sum()))], np.flatnonzero(used)
    if brightness is not None:
        parts = find_parts(row, spread(brightness), chance)
        line = _fit_decay(row, parts, brightness)
        if line is not None:
            share = line[-1] / line[0]
            detail = (
                f"all ON {'rises' if share > 1 else 'falls'} steadily, to {share:.3g} times its "
                "first brightness: each scene has a budget of its own"
            )
            fault = Fault(kind="level", detail=detail)
            return np.interp(np.arange(len(used)), places, line), [fault]
    starts = [0, *(int(places[part.start]) for part in parts[1:]), len(used)]
    flux = np.concatenate(
        [
            np.full(b - a, _mean(row, part))
            for (a, b), part in zip(pairwise(starts), parts, strict=True)
        ]
    )
    scenes = curve.scenes[places]
    faults = [_name_step(row, scenes, one, other) for one, other in pairwise(parts)]
    return flux, faults


def _mean(row: Row, part: slice) -> float:
    """Rate of passes together, counts/s."""
    return float(row.counts[part].sum() / row.seconds[part].sum())


def _fit_decay(row: Row, parts: list[slice], brightness: Brightness) -> np.ndarray | None:
    """Rates (P,) of a light that rises or falls steadily, if it does, and not in steps."""
    passes = len(row.counts)
    if passes < LEAST_FOR_DECAY or not (row.counts > 0).all():
        return None
    logs, when = np.log(row.counts / row.seconds), np.arange(passes) - (passes - 1) / 2
    line = logs.mean() + when * ((logs @ when) / (when @ when))
    change = abs(float(line[-1] - line[0]))
    noise = brightness.within**2 + float((row.variances / row.counts**2).mean())
    error = np.sqrt(noise / (when @ when)) * (passes - 1)
    # Two classes one after the other are a step, and the line through it is half as much longer.
    sound = 1.5 * np.log(brightness.between) + SPREAD_SIGMAS * error + HARMLESS
    if len(parts) == 1 and change <= sound:
        return None
    steps = np.concatenate([np.full(part.stop - part.start, _mean(row, part)) for part in parts])
    free = max(passes - 2 * len(parts) + 1, 1)
    by_line = float(((logs - line) ** 2).sum()) / (passes - 2)
    by_steps = float(((logs - np.log(steps)) ** 2).sum()) / free
    return np.asarray(np.exp(line)) if by_line < by_steps else None


def _name_step(row: Row, scenes: np.ndarray, before: slice, after: slice) -> Fault:
    first, last = scenes[after.start], scenes[after.stop - 1]
    some = f"scenes {first} to {last}" if last > first else "this scene"
    detail = (
        f"all ON is {_mean(row, after) / max(_mean(row, before), 1e-300):.3g} times as bright as "
        f"before, and scenes do not differ so much: {some} have a budget of their own"
    )
    return Fault(kind="level", scene=int(first), detail=detail)


def spread(known: Brightness) -> Allowed:
    """Ratio by which the mean brightness of two groups of scenes may differ."""
    most = RANGE_SLACK * np.log(known.high / known.low) if known.low > 0 else np.inf

    def allowed(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        noise = SPREAD_SIGMAS * known.within * np.sqrt(1 / one + 1 / other)
        return np.exp(np.minimum(np.log(known.between) + noise, most)) * (1 + HARMLESS)

    return allowed


def _find_blind(detectors: list[LightCurve], backgrounds: list[Background]) -> list[Fault]:
    """Detectors that certainly see less than `HARMLESS` of the light that they see in the mean."""
    bright = [curve.together(curve.bright) for curve in detectors]
    photons = np.array([float(found.sum()) for found, _ in bright])
    pairs = zip(backgrounds, bright, strict=True)
    dark = np.array([float(each.rate @ seconds) for each, (_, seconds) in pairs])
    wanted = HARMLESS * max(float((photons - dark).sum()), 0.0) / max(len(detectors), 1)
    lacks = dark + wanted - photons
    blind = lacks > CERTAIN_SIGMAS * np.sqrt(dark + photons + 1)
    faults = []
    for place in np.flatnonzero(blind).tolist():
        detail = (
            f"almost no light{detectors[place].name} in all scenes together: their parts that this "
            "detector sees are dark, or it is not wired to that input"
        )
        faults.append(Fault(kind="blind", detail=detail))
    return faults


def name_backgrounds(curve: LightCurve, background: Background) -> list[Fault]:
    """Changes of the background; counts are rid of each scene's own."""
    faults, rate = [], background.rate
    for part in background.parts[1:]:
        detail = (
            f"dark frames{curve.name} have {rate[part.start]:.4g} counts/s, and "
            f"{rate[part.start - 1]:.4g} before: the background is that of scenes from here on"
        )
        scene = int(curve.scenes[part.start])
        faults.append(Fault(kind="background", scene=scene, detail=detail))
    return faults
