"""Light of each pass checked against physics, by its all-ON and all-OFF frames and within frames.

- ON is brighter than OFF, or there is no light.
- Both ON frames of a pass are equally bright, and both OFF frames: the scene is the same.
- Within a frame the light is steady: the mask is the same.
- No mask sends more light than all mirrors ON.
- Light has no rhythm.

Each law is tested with exact chances, `tails.FALSE_ALARMS` for all passes and laws together. What
is below `HARMLESS` is left alone, however certain it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from deepfsi.hardware.light.faults import Fault
from deepfsi.hardware.light.flicker import Periodogram
from deepfsi.hardware.light.levels import Row, find_parts
from deepfsi.hardware.light.tails import EXCESS, excess_chance
from deepfsi.hardware.patterns.sequence import Frame

PARTS = 8
"""Parts of each frame that are counted by themselves."""

LAWS = 8
"""Tests that share `FALSE_ALARMS`: the laws above (two for a rhythm), levels and backgrounds."""

HARMLESS = 0.05
"""Change of a light that is left alone, as a share of it."""

HARMLESS_DARK = 0.02
"""Change of the background that is left alone, as a share of the light with all mirrors ON."""

RESTLESS_SHARE = 0.1
"""Share of passes in which the light must be unsteady for the others to be in doubt."""

LOOKED_AT_SIGMAS = 3.0
"""Standard errors below which a part of a frame is not worth an exact test."""

_SPLITS = np.array(
    [
        (np.arange(PARTS) >= first) & (np.arange(PARTS) < stop)
        for first in range(PARTS)
        for stop in range(first + 1, PARTS + 1)
        if stop - first < PARTS and (first == 0 or stop < PARTS)
    ],
    float,
)
"""Parts of a frame that are held against its others, each way."""

_NAMED_FRAMES = 5
"""Frames that a fault lists at most."""


@dataclass(frozen=True)
class LightCurve:
    """Light over time, of an arm's detectors together or of one: photons in parts of each frame."""

    # (P, F, K): Photons, and how long each part was open: 0 where a frame's time is not known. K is
    # `PARTS`, or 1 where frames were counted whole
    photons: np.ndarray
    seconds: np.ndarray  # (P, F, K)
    middles: np.ndarray  # (F, K): Times of the parts after the start of their pass, seconds
    scenes: np.ndarray  # (P,): Scene of each pass
    # Places of the two frames that send it all light, and of those that send it none
    bright: tuple[int, int]
    dark: tuple[int, int]
    frames: tuple[Frame, ...]  # that were shown
    name: str  # what to call the inputs in a fault; empty if there is but one arm
    part: bool = False  # true for a detector that sees a part of the device, which may be dark

    def of(self, frames: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Photons and seconds of some frames, each (P, frames)."""
        places = list(frames)
        return self.photons[:, places].sum(axis=2), self.seconds[:, places].sum(axis=2)

    def together(self, frames: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Photons and seconds of some frames together, each (P,)."""
        photons, seconds = self.of(frames)
        return photons.sum(axis=1), seconds.sum(axis=1)


@dataclass(frozen=True)
class Background:
    """Counts of an input without light, from the passes that agree with each."""

    photons: np.ndarray  # (P,): Of all-OFF frames; for the second of two arms, of all-ON ones
    seconds: np.ndarray  # (P,)
    parts: list[slice]  # passes that agree with each other

    @property
    def rate(self) -> np.ndarray:
        """Counts/s, (P,)."""
        return self.photons / np.where(self.seconds > 0, self.seconds, 1.0)


@dataclass(frozen=True)
class Checked:
    """Findings on the light of an arm, or of one of its detectors."""

    background: Background
    lit: np.ndarray  # (P,): bool; passes with light
    # (P,): bool; those of them in which it was steady, and no frame brighter than all ON
    sound: np.ndarray
    faults: tuple[Fault, ...]


def check_light(curve: LightCurve, lost: np.ndarray, chance: float) -> Checked:
    """Check the light of an arm, or of one of its detectors."""
    each, periodogram = chance / LAWS, Periodogram()
    periodogram.add(curve.photons, curve.seconds, curve.middles)
    rhythm = find_rhythm(curve, periodogram, each)
    return check_passes(curve, find_background(curve, each), rhythm, lost, each)


def check_passes(
    curve: LightCurve,
    background: Background,
    rhythm: tuple[Fault, ...],
    lost: np.ndarray,
    each: float,
) -> Checked:
    """Check the light of passes whose background and rhythm are known."""
    lit = _find_lit(curve, background, each)
    looked_at = np.ones_like(lit) if curve.part else lit  # what sees a part need not be lit
    on, on_s = curve.together(curve.bright)
    light = np.maximum(on / np.where(on_s > 0, on_s, 1.0) - background.rate, 0.0)
    drift = _find_drifts(curve, background, light, each)
    restless = _find_restless(curve, light, each)
    brighter = _find_brighter(curve, each)
    faults = list(rhythm)
    sound = looked_at.copy()
    for place, scene in enumerate(curve.scenes.tolist()):
        if not looked_at[place]:
            faults.append(_name_dark(curve, place, scene))
            continue
        if brighter[place].any():
            faults.append(_name_brighter(curve, place, brighter[place]))
            sound[place] = False
        unsteady = drift[place].any() or restless[place].any()
        if unsteady and not rhythm:
            why = (drift[place], restless[place])
            faults.append(_name_unsteady(curve, place, *why))
        sound[place] &= not unsteady
    if not rhythm:
        faults += find_restless_lamp(curve.scenes, looked_at, sound, lost)
    return Checked(background, lit, sound, tuple(faults))


def find_restless_lamp(
    scenes: np.ndarray, lit: np.ndarray, sound: np.ndarray, lost: np.ndarray
) -> list[Fault]:
    """Fault of the whole recording if the light was wrong in many of its passes."""
    # One disturbance may reach into two passes that follow each other
    wrong = np.concatenate([scenes[lit & ~sound], lost])
    passes = np.count_nonzero(lit) + len(lost)
    if len(wrong) < max(2, RESTLESS_SHARE * passes) or np.ptp(wrong) < 2:
        return []
    detail = (
        f"the light was unsteady in {len(wrong)} of {passes} passes, so it may have "
        "been in others: use a steady lamp, and keep stray light out"
    )
    return [Fault(kind="flicker", detail=detail)]


def find_background(curve: LightCurve, chance: float) -> Background:
    """Background of each pass: that of its own dark frames and of its neighbours that agree."""
    photons, seconds = curve.together(curve.dark)
    usual = (photons.sum() + 1) / max(seconds.sum(), 1e-300)
    ratio = 1 + HARMLESS_DARK * _usual_light(curve) / usual
    parts = find_parts(Row(photons, photons, seconds), lambda *_: np.array(ratio), chance)
    pooled, pooled_s = photons.astype(np.float64), seconds.copy()
    for part in parts:
        pooled[part], pooled_s[part] = photons[part].sum(), seconds[part].sum()
    return Background(pooled, pooled_s, parts)


def _usual_light(curve: LightCurve) -> float:
    """Median over passes of the rate with all light less that with none, counts/s."""
    (on, on_s), (off, off_s) = curve.together(curve.bright), curve.together(curve.dark)
    known = (on_s > 0) & (off_s > 0)
    if not known.any():
        return 0.0
    return max(0.0, float(np.median(on[known] / on_s[known] - off[known] / off_s[known])))


def _find_lit(curve: LightCurve, background: Background, chance: float) -> np.ndarray:
    """Passes (P,) whose bright frames, alone or with the masks', are brighter than the dark."""
    masks = [k for k in range(curve.photons.shape[1]) if k not in curve.dark]
    lit = np.zeros(len(curve.scenes), bool)
    for frames in (curve.bright, masks):
        photons, seconds = curve.together(frames)
        chances = excess_chance(photons, seconds, background.photons, background.seconds)
        lit |= chances * 2 * len(lit) <= chance
    return lit


def _find_drifts(
    curve: LightCurve, background: Background, light: np.ndarray, chance: float
) -> np.ndarray:
    """Passes whose two bright frames, or two dark ones, differ: (P, 2)."""
    out = np.zeros((len(light), 2), bool)
    floor = (background.photons + 1) / np.where(background.seconds > 0, background.seconds, 1.0)
    ratios: list[np.ndarray | float] = [1 + HARMLESS, 1 + HARMLESS_DARK * light / floor]
    for column, (frames, ratio) in enumerate(zip((curve.bright, curve.dark), ratios, strict=True)):
        photons, seconds = curve.of(frames)
        for one, other in ((0, 1), (1, 0)):
            chances = excess_chance(
                photons[:, one], seconds[:, one], photons[:, other], seconds[:, other], ratio
            )
            out[:, column] |= chances * 2 * len(light) <= chance
    return out


def _find_restless(curve: LightCurve, light: np.ndarray, chance: float) -> np.ndarray:
    """Frames (P, F) in which the light is not steady."""
    whole, whole_s = curve.photons.sum(axis=2), curve.seconds.sum(axis=2)
    out = np.zeros(whole.shape, bool)
    if curve.photons.shape[2] < PARTS:
        return out  # frames were counted whole
    rate = (whole + 1) / np.where(whole_s > 0, whole_s, np.inf)
    ratio = 1 + np.maximum(HARMLESS, HARMLESS_DARK * light[:, None] / np.maximum(rate, 1e-300))
    ratio = np.where(whole_s > 0, ratio, 1.0)
    tests = 2 * len(_SPLITS) * whole.size
    for split in _SPLITS:
        part, part_s = curve.photons @ split, curve.seconds @ split
        share = part_s / np.where(whole_s > 0, whole_s, 1.0)
        noise = np.sqrt(np.maximum(whole * share * (1 - share), 1e-300))
        far = np.abs(part - whole * share) > LOOKED_AT_SIGMAS * noise
        own = part[far], part_s[far]
        rest = (whole - part)[far], (whole_s - part_s)[far]
        more = excess_chance(*own, *rest, ratio[far])
        less = excess_chance(*rest, *own, ratio[far])
        out[far] |= np.minimum(more, less) * tests <= chance
    return out


def _find_brighter(curve: LightCurve, chance: float) -> np.ndarray:
    """Masks' frames (P, F) that are brighter than those of their pass with all light."""
    photons, seconds = curve.photons.sum(axis=2), curve.seconds.sum(axis=2)
    on, on_s = curve.together(curve.bright)
    chances = excess_chance(photons, seconds, on[:, None], on_s[:, None], 1 + HARMLESS)
    out = chances * photons.size <= chance
    out[:, [*curve.bright, *curve.dark]] = False
    return out


def find_rhythm(curve: LightCurve, periodogram: Periodogram, chance: float) -> tuple[Fault, ...]:
    """Fault of the whole recording if its light has a rhythm, or varies fast in another way."""
    # The periodogram is of all frames, and the curve needs no more than the all-ON ones
    found = periodogram.strongest(chance)
    if found is not None:
        hertz, amplitude = found
        shown = [each.picture_us for each in curve.frames if each.role == "mask"]
        frame_s = float(np.mean(shown)) * 1e-6
        averaged = min(1.0, 1 / (np.pi * hertz * frame_s))
        if amplitude * averaged >= HARMLESS:
            detail = (
                f"the light{curve.name} rises and falls by {amplitude:.0%} at {hertz:.4g} Hz: use "
                "a lamp that does not"
            )
            return (Fault(kind="flicker", detail=detail),)
    photons, seconds = curve.of(curve.bright)
    known = (seconds > 0).all(axis=1) & (photons.sum(axis=1) > 0)
    photons, seconds = photons[known].astype(np.float64), seconds[known]
    if len(photons) < 3:
        return ()
    both, share = photons.sum(axis=1), seconds[:, 0] / seconds.sum(axis=1)
    spread = both * share * (1 - share)
    off = photons[:, 0] - both * share
    steps = off**2 / (EXCESS * spread + (HARMLESS * spread) ** 2)
    left = float(steps.sum() - steps.max())
    if chdtrc(len(steps) - 1, left) > chance:
        return ()
    size = np.sqrt(max(float((off**2 - EXCESS * spread).mean()), 0.0) / float((spread**2).mean()))
    detail = (
        f"the all-{'ON' if curve.bright[0] == 0 else 'OFF'} frames of a pass{curve.name} differ by "
        f"{size:.0%} (rms over passes), more than their photons' noise: use a steady lamp"
    )
    return (Fault(kind="flicker", detail=detail),)


def _name_dark(curve: LightCurve, place: int, scene: int) -> Fault:
    (on, on_s), (off, off_s) = (
        (float(photons[place]), float(seconds[place]))
        for photons, seconds in (curve.together(curve.bright), curve.together(curve.dark))
    )
    detail = (
        f"no light{curve.name}: {on / max(on_s, 1e-300):.4g} counts/s with all light, "
        f"{off / max(off_s, 1e-300):.4g} with none"
    )
    return Fault(kind="dark", scene=scene, detail=detail)


def _name_brighter(curve: LightCurve, place: int, which: np.ndarray) -> Fault:
    photons, seconds = curve.photons[place].sum(axis=1), curve.seconds[place].sum(axis=1)
    on, on_s = curve.together(curve.bright)
    rates = photons / np.where(seconds > 0, seconds, np.inf) * (on_s[place] / max(on[place], 1))
    frame = int(np.argmax(np.where(which, rates, 0)))
    detail = (
        f"{curve.frames[frame]}{curve.name} is {rates[frame]:.3g} times as bright as all light"
        f"{_list_frames(which)}: stray light, or a lamp that went down for the all-ON frames, or "
        "a counter that is blind at this rate"
    )
    return Fault(kind="brighter", scene=int(curve.scenes[place]), frame=frame, detail=detail)


def _name_unsteady(curve: LightCurve, place: int, drift: np.ndarray, restless: np.ndarray) -> Fault:
    scene = int(curve.scenes[place])
    if restless.any():
        off = curve.photons[place] - curve.photons[place].mean(axis=1, keepdims=True)
        strength = (off**2).sum(axis=1) / np.maximum(curve.photons[place].sum(axis=1), 1)
        frame = int(np.argmax(np.where(restless, strength, -1)))
        parts = ", ".join(f"{many:.0f}" for many in curve.photons[place, frame].tolist())
        detail = (
            f"light{curve.name} changed within {curve.frames[frame]}: {parts} photons in its "
            f"parts{_list_frames(restless)}"
        )
        return Fault(kind="unsteady", scene=scene, frame=frame, detail=detail)
    frames = curve.bright if drift[0] else curve.dark
    one, other = (float(curve.photons[place, frame].sum()) for frame in frames)
    detail = (
        f"light{curve.name} changed within the pass: {one:.0f} photons in "
        f"{curve.frames[frames[0]]} at its start, {other:.0f} at its end"
    )
    return Fault(kind="unsteady", scene=scene, detail=detail)


def _list_frames(which: np.ndarray) -> str:
    """Frames of a fault, if they are several, as an insertion."""
    places = np.flatnonzero(which).tolist()
    if len(places) < 2:
        return ""
    more = f" and {len(places) - _NAMED_FRAMES} more" if len(places) > _NAMED_FRAMES else ""
    return f" (frames {', '.join(map(str, places[:_NAMED_FRAMES]))}{more})"
