"""Counts of any counter: a table with a value for each frame and input becomes `Counts`.

A value is what the counter counted from one frame's marker to the next, or from `settle` after it.
Pictures last longer than their share of the exposure asks for, so the value of frame f, counted for
the time T_f, becomes that of its gate,

    value · share_f · E / T_f,      E = Σ T_f / Σ share_f  over the masks' frames,

and the budget is the flux times E: all the light of these frames.
"""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.models import Amount, Positive, UserModel
from deepfsi.base.quantities import time_text
from deepfsi.base.tables import NumberTable
from deepfsi.camera.dead_time import NO_DEAD_TIME, DeadTime
from deepfsi.counting.acquisition import MOST_READOUTS, Scene
from deepfsi.counting.checks import Light, check_light
from deepfsi.counting.counts import (
    ALL_OFF,
    ALL_ON,
    ENDS,
    Corrections,
    Counts,
    light_of_clicks,
    refuse_photon_settings,
)
from deepfsi.counting.flux import Arrivals
from deepfsi.patterns.manifest import Manifest


class TableSettings(UserModel):
    """Settings of a table of counts."""

    WORDS: ClassVar[tuple[str, ...]] = ("scene", "label")  # names of the columns of words

    photons: Positive | None = None  # budget of an exposure, counts
    background: Amount | None = None  # dark counts of an input in one exposure
    settle_s: Amount = 0.0  # time after each marker that was not counted, seconds
    gain: Positive | None = None  # counts for one unit of the table, of an analogue detector
    read_noise: Amount | None = None  # of each value of an analogue detector, counts rms
    dead_time: DeadTime = NO_DEAD_TIME  # of a photon counter, to be corrected for
    clicks: int | None = None  # gates of a frame, of tables of clicks: values from 0 to this

    @property
    def analogue(self) -> bool:
        """True for values that are no photon counts."""
        return self.gain is not None or self.read_noise is not None


def column_names(manifest: Manifest) -> list[str]:
    """Names of the values of an exposure, frame by frame, and input by input in a frame."""
    # `on`, `off`, then `mask0` (of a single rail, or two arms) or `mask0+` and `mask0-`, last `on2`
    # and `off2`; of several inputs `mask0+/1`, `mask0+/2` and so on
    names: list[str] = []
    for frame in manifest.frames:
        name: str = frame.role
        if frame.role == "mask":
            sign = "" if manifest.rails == 1 or frame.rail == "both" else "+-"[frame.rail != "plus"]
            name = f"mask{frame.mask}{sign}"
        names.append(f"{name}2" if name in names else name)
    if manifest.inputs == 1:
        return names
    return [f"{name}/{number}" for name in names for number in range(1, manifest.inputs + 1)]


def count_table(
    table: NumberTable, manifest: Manifest, settings: TableSettings, name: str = "the table"
) -> tuple[Counts, tuple[Scene, ...]]:
    """Counts of the exposures in a table, and their scenes."""
    dead_time = bool(settings.dead_time.seconds)
    if settings.analogue and dead_time:
        raise InputError(
            "an analogue detector counts no photons: leave `dead_time` out, or `gain` and "
            "`read_noise`"
        )
    if settings.clicks is not None:
        stated = settings.background, settings.gain, settings.read_noise, dead_time or None
        refuse_photon_settings(*stated)
    values = _arrange(table, manifest, name)
    with_ends = values.shape[1] == len(manifest.frames)
    if not with_ends:
        # zeros for the sentinels, so that frames keep their indices
        values = np.pad(values, ((0, 0), (2, 2), (0, 0)))
    _check_values(values, settings, name)
    seconds = np.asarray(manifest.picture_s - settings.settle_s)  # of each frame (F,)
    if seconds.min() <= 0:
        raise InputError(
            f"`settle` {time_text(settings.settle_s)} leaves nothing of the shortest frame: "
            f"give less than {manifest.picture_s.min():g}"
        )
    masks = manifest.mask_frames
    exposure_s = float(seconds[masks].sum() / manifest.shares.sum())
    scenes, scene_of = _find_scenes(table, len(values), name)
    arrivals, variance = _correct(values, seconds, manifest, settings, name)
    repeats = np.bincount(scene_of)
    if with_ends:
        light = _find_light(arrivals, variance, seconds, scene_of, manifest, settings)
    else:
        unknown = np.full(len(repeats), (settings.photons or np.nan) / exposure_s)
        light = Light(unknown, np.zeros((len(repeats), manifest.inputs)))
    if settings.background is not None:
        dark = np.full_like(light.dark_rate, settings.background / exposure_s)
        flux = light.flux
        if with_ends:
            # the flux is beyond the measured background, and shall be beyond the stated one
            flux = flux + (light.dark_rate - dark)[:, manifest.on_inputs].sum(axis=1)
        light = replace(light, flux=flux, dark_rate=dark)
    if settings.photons is None and not (light.flux > 0).any():
        raise InputError(
            f"{name} does not tell its budget: it has no all-ON and all-OFF frames, or they are "
            "equally bright, or all gates click; look at the order of frames, or give `photons`"
        )
    valid = np.arange(repeats.max()) < repeats[:, None]

    def by_scene(of_frames: np.ndarray) -> np.ndarray:
        """Readouts (S, R, rails, m[, D]) of masks' frames (E, f, inputs)."""
        readouts = manifest.by_readout(of_frames)
        out = np.zeros((*valid.shape, *readouts.shape[1:]))
        out[valid] = readouts
        return out

    lengths_s = manifest.shares * exposure_s
    scale = (lengths_s / seconds[masks])[:, None]
    if settings.clicks is not None:
        scale = np.ones_like(scale)  # they are not in proportion to the time
    counts = Counts(
        counts=by_scene(values[:, masks]),
        arrivals=by_scene(arrivals[:, masks] * scale),
        variance=by_scene(variance[:, masks] * scale**2),
        valid=valid,
        flux=light.flux,
        dark_rate=manifest.by_rail(light.dark_rate),
        exposure_s=exposure_s,
        settle_s=settings.settle_s,
        lengths_s=manifest.lengths_by_readout(lengths_s),
        drift=0.0,
        inputs=tuple(range(manifest.inputs)),
        faults=light.faults,
        dead_time=settings.dead_time,
        gates=settings.clicks,
    )
    return counts, scenes


def _correct(
    values: np.ndarray, seconds: np.ndarray, manifest: Manifest, settings: TableSettings, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Arrivals (E, F, inputs) in all frames, and their variance (E, F, inputs)."""
    if settings.clicks is not None:
        return values, values * (1 - values / settings.clicks)
    if settings.analogue:
        counts = values * (settings.gain or 1.0)
        return counts, counts.clip(min=0) + (settings.read_noise or 0.0) ** 2
    rates = values / seconds[:, None]
    corrections = Corrections.of(settings.dead_time, manifest)
    corrections.check(rates, manifest.frames, range(manifest.inputs), name)
    factors = corrections.factors(rates)
    return values * factors.arrivals, values * factors.variance


def _arrange(table: NumberTable, manifest: Manifest, name: str) -> np.ndarray:
    """Values (E, F, inputs) of all frames, or of the masks' alone."""
    names = column_names(manifest)
    inputs = manifest.inputs
    masks = names[2 * inputs : -2 * inputs]
    rows, columns = table.values.shape
    if columns not in (len(masks), len(names)):
        frames = f"{len(masks) // inputs} frames of masks"
        if inputs > 1:
            frames += f" x {inputs} inputs"
        raise InputError(
            f"{name} has {rows} rows and {columns} columns: an exposure is a row of {len(masks)} "
            f"values ({frames}), or {len(names)} with all ON and all OFF before and after them"
        )
    asked = names if columns == len(names) else masks
    for column, wanted in zip(table.names, asked, strict=False):
        if column.lower() in names and column.lower() != wanted:
            raise InputError(
                f"{name} has {column!r} where {wanted!r} stands: put columns into the order of the "
                "frames"
            )
    return table.values.reshape(rows, -1, inputs)


def _find_scenes(
    table: NumberTable, exposures: int, name: str
) -> tuple[tuple[Scene, ...], np.ndarray]:
    """Scenes, and the scene of each exposure (E,); without names each exposure is a scene."""
    names = table.words.get("scene")
    labels = table.words.get("label")
    scene_of = np.arange(exposures)
    if names is None:
        names = tuple(str(number + 1) for number in range(exposures))
    else:
        changes = [a != b for a, b in zip(names[1:], names, strict=False)]
        scene_of = np.cumsum([0, *changes])
        if len(set(names)) <= scene_of[-1]:
            raise InputError(f"{name} has a scene twice, with others between: sort its rows")
    firsts = np.searchsorted(scene_of, np.arange(scene_of[-1] + 1)).tolist()
    scenes = (Scene(name=names[k], label=(labels[k] or None) if labels else None) for k in firsts)
    return tuple(scenes), scene_of


def _check_values(read: np.ndarray, settings: TableSettings, name: str) -> None:
    """Raise `InputError` for too many values, or values that are no counts or clicks."""
    if read[:, 2:-2].size > MOST_READOUTS:
        raise InputError(f"{name} holds more than {MOST_READOUTS} values: split it")
    most = settings.clicks or np.inf
    wrong = read[(read < 0) | (read % 1 != 0) | (read > most)]
    if wrong.size and not settings.analogue:
        allowed = f"to {settings.clicks} clicks" if settings.clicks else "or more"
        raise InputError(
            f"{name} holds {wrong[0]:g}, which is no count: give whole numbers, 0 {allowed}, or "
            "`gain` and `read_noise` of an analogue detector"
        )


def _find_light(
    arrivals: np.ndarray,
    variance: np.ndarray,
    seconds: np.ndarray,
    scene_of: np.ndarray,
    manifest: Manifest,
    settings: TableSettings,
) -> Light:
    """Light of each scene, from the all-ON and all-OFF frames of exposures of `scene_of` (E,)."""
    scenes = int(scene_of[-1]) + 1
    arm = manifest.on_inputs
    if settings.clicks is not None:
        clicks = arrivals[:, ENDS]
        width = float(seconds[0]) / settings.clicks
        flux, dark = light_of_clicks(
            clicks, clicks, gates=settings.clicks, width_s=width, manifest=manifest
        )
        return Light(np.full(scenes, flux), np.tile(dark, (scenes, 1)))
    photons, noise = np.zeros((2, scenes, *arrivals.shape[1:]))
    np.add.at(photons, scene_of, arrivals)
    np.add.at(noise, scene_of, variance)
    spent = np.bincount(scene_of)[:, None] * seconds
    if not settings.analogue:
        arrived = Arrivals(manifest.frames, photons, noise, spent)
        return check_light(arrived, manifest, range(manifest.inputs))
    # Means over the table: the light's checks are of photons
    on, off = (
        photons[:, ends].sum(axis=1) / spent[:, ends].sum(axis=1, keepdims=True)
        for ends in (ALL_ON, ALL_OFF)
    )
    dark = off.copy()
    dark[:, arm.stop :] = on[:, arm.stop :]  # the second arm is dark when all are ON
    dark[:] = dark.mean(axis=0)
    return Light(np.full(scenes, (on - off)[:, arm].sum(axis=1).mean()), dark)
