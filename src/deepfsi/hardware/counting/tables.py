"""Counts of any counter: a table with a value for each frame and input becomes `Counts`.

A value is what the counter counted from one frame's marker to the next, or from `settle` after it.
Pictures last longer than their share of the exposure asks for, so the value of frame f, counted for
the time T_f, becomes that of its gate,

    value · share_f · E / T_f,      E = Σ T_f / Σ share_f  over the masks' frames,

and the budget is the flux times E: all the light of these frames.

Counters that give no events give cumulative counts at triggers, or counts in even time bins: both
become such a table, a row for each pass and a value for each frame and input. Bins have no marker,
so passes are found by their light: all ON, then all OFF, at both ends, and no frame brighter. Of
the places s that fit it is the one at which counts are most likely to be constant within each
frame, by the logarithm of the likelihood

    G(s) = Σ_f [S_f log(S_f / n_f) − Σ_b k_b log k_b],    S_f the counts k_b of the n_f bins of f.

The first bin of each frame may hold light of the frame before and is left out: a frame is counted
one bin less than it is shown.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self, get_args

import numpy as np

from deepfsi.base.errors import InputError, Message, check_choice, closest_choice
from deepfsi.base.numeric.tables import NumberTable
from deepfsi.base.quantities import time_text
from deepfsi.camera.dead_time import NO_EFFECTS, CounterEffects
from deepfsi.hardware.counting.acquisition import MOST_READOUTS, Scene
from deepfsi.hardware.counting.corrections import (
    ALL_OFF,
    ALL_ON,
    ENDS,
    Ambient,
    Estimate,
    check_clicks,
    correct,
    corrections_of,
    light_of_clicks,
    variance_of_clicks,
)
from deepfsi.hardware.counting.counts import Counts, RunLight
from deepfsi.hardware.light.checks import Fault, check_light
from deepfsi.hardware.light.curves import CERTAIN_SIGMAS, Arrivals
from deepfsi.hardware.patterns.manifest import Manifest

ROLL_OVER = 2**32
"""Counts after which a cumulative counter begins again."""

CERTAIN_GAIN = 10.0
"""Logarithm of the odds by which one place of a pass is likelier than any other."""

SMALLEST = float(np.nextafter(0, 1))
"""Smallest number above 0."""

LEAST_BINS = 2
"""Bins that a frame is shown for at least, one of which is left out."""

Along = Literal["rows", "columns"]
"""Exposures are the rows of a table, or its columns."""


@dataclass(frozen=True)
class TableSettings:
    """Settings with which a table is read; `InputError` if one of them is not allowed."""

    SCENE: ClassVar[str] = "scene"
    LABEL: ClassVar[str] = "label"
    WORDS: ClassVar[tuple[str, ...]] = (SCENE, LABEL)  # names of the columns of words

    photons: float | None = None  # budget of an exposure, counts
    background: float | None = None
    settle_s: float = 0.0  # time after each marker that was not counted, seconds
    exposures: str | None = None  # as the shape says unless given
    repeats: int = 1  # exposures of each scene, one after another, where the table names no scenes
    gain: float | None = None  # counts for a unit of the table, of an analogue detector
    read_noise: float | None = None  # of each value of an analogue detector, counts rms
    effects: CounterEffects = NO_EFFECTS  # of a photon counter, to be corrected for
    dark: NumberTable | None = None  # exposures with the scene dark, whose counts are subtracted
    clicks: int | None = None  # gates of a frame, of tables of clicks: values from 0 to this

    def __post_init__(self) -> None:
        if self.exposures is not None:
            check_choice(
                Message("{exposures}", setting="exposures"), self.exposures, get_args(Along)
            )
        for name, least, allowed in (
            ("photons", SMALLEST, "a number above 0"),
            ("gain", SMALLEST, "a number above 0"),
            ("background", 0, "counts, 0 or more"),
            ("read_noise", 0, "counts, 0 or more"),
            ("repeats", 1, "1 or more"),
        ):
            value = getattr(self, name)
            if value is not None and not least <= value < np.inf:
                raise InputError(
                    "{setting} {value:g} is not allowed: give {allowed}",
                    setting=name,
                    value=value,
                    allowed=allowed,
                )
        if self.analogue and self.effects.dead_time.seconds:
            raise InputError(
                "an analogue detector counts no photons: leave {dead_time} out, or {gain} and "
                "{read_noise}",
                setting=("dead_time", "gain", "read_noise"),
            )
        if self.clicks is not None:
            of_photons: dict[str, bool] = {
                Message("{background}", setting="background"): (
                    self.background is not None or self.dark is not None
                ),
                Message("{dead_time}", setting="dead_time"): bool(self.effects.dead_time.seconds),
                Message("{gain} or {read_noise}", setting=("gain", "read_noise")): self.analogue,
            }
            check_clicks(self.clicks, of_photons)

    @property
    def analogue(self) -> bool:
        """True for values that are no photon counts."""
        return self.gain is not None or self.read_noise is not None


def column_names(manifest: Manifest) -> list[str]:
    """Names of the values of an exposure: frame by frame, and in each frame input by input."""
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
    exposures = _Exposures.read(table, manifest, settings, name)
    scenes, scene_of = _find_scenes(table, len(exposures.values), settings, name)
    frames = exposures.correct()
    light = _find_light(exposures, frames, scene_of)
    ambient = Ambient.none(manifest)
    if settings.dark is not None:
        dark = _Exposures.read(settings.dark, manifest, settings, "the table of the background")
        ambient = dark.as_ambient(exposures.sentinels)
        light = replace(light, flux=ambient.of_flux(light.flux, name))
    repeats = np.bincount(scene_of)
    valid = np.arange(repeats.max()) < repeats[:, None]

    def by_scene(of_frames: np.ndarray) -> np.ndarray:
        """Readouts (S, R, rails, m[, D]) from those of masks' frames (E, f, inputs)."""
        readouts = manifest.by_readout(of_frames)
        out = np.zeros((*valid.shape, *readouts.shape[1:]))
        out[valid] = readouts
        return out

    gated = exposures.in_gates(frames)
    counts = Counts(
        **vars(light),
        counts=by_scene(exposures.values[:, manifest.shown]),
        arrivals=by_scene(gated.arrivals),
        variance=by_scene(gated.variance),
        valid=valid,
        gate_s=exposures.lengths_s,
        exposure_s=exposures.exposure_s,
        settle_s=settings.settle_s,
        lengths_s=manifest.lengths_by_readout(exposures.lengths_s),
        drift=0.0,
        ambient=ambient.counts,
        ambient_variance=ambient.variance,
        inputs=tuple(range(manifest.inputs)),
        effects=settings.effects,
        gates=settings.clicks,
    )
    if settings.photons is None and not exposures.sentinels:
        raise InputError(
            "{name} has no all-ON and all-OFF frames, which tell the budget: give {photons}",
            setting="photons",
            name=name,
        )
    if settings.photons is None and counts.gates is not None:
        counts.check_budget(name)
    if settings.photons is None and not (counts.flux > 0).any():
        raise InputError(
            "{name} has no light: its all-ON frames are not brighter than the all-OFF ones; look "
            "at the order of frames, or give {photons}",
            setting="photons",
            name=name,
        )
    return counts, scenes


@dataclass(frozen=True)
class _Exposures:
    """Frames of the exposures in a table, each counted as one window."""

    values: np.ndarray  # (E, F, inputs): Counts; 0 in all-ON and all-OFF frames that are not there
    sentinels: bool  # whether these are there
    seconds: np.ndarray  # (F,): For how long each frame was counted
    manifest: Manifest
    settings: TableSettings
    name: str

    @classmethod
    def read(
        cls, table: NumberTable, manifest: Manifest, settings: TableSettings, name: str
    ) -> Self:
        """Exposures of a table, or `InputError` if it does not hold them."""
        values = _arrange(table, manifest, settings, name)
        sentinels = values.shape[1] == len(manifest.frames)
        if not sentinels:
            values = np.pad(values, ((0, 0), (2, 2), (0, 0)))
        _check_values(values, manifest, settings, name)
        seconds = np.asarray(manifest.picture_s - settings.settle_s)
        if seconds.min() <= 0:
            raise InputError(
                "{settle} {given} leaves nothing of the shortest frame: give less than "
                "{shortest_s:g}",
                setting="settle",
                given=time_text(settings.settle_s),
                shortest_s=manifest.picture_s.min(),
            )
        return cls(values, sentinels, seconds, manifest=manifest, settings=settings, name=name)

    @property
    def exposure_s(self) -> float:
        """Total exposure: all the light of the masks' frames is counted."""
        return float(self.seconds[self.manifest.shown].sum() / self.manifest.shares.sum())

    @property
    def lengths_s(self) -> np.ndarray:
        """Gates (f,) that have the masks' shares of the exposure."""
        return self.manifest.shares * self.exposure_s

    def correct(self) -> Estimate:
        """Arrivals (E, F, inputs) in all frames."""
        values = self.values
        settings = self.settings
        if settings.clicks is not None:
            return Estimate(values, variance_of_clicks(values, settings.clicks))
        if settings.analogue:
            counts = values * (settings.gain or 1.0)
            return Estimate(counts, counts.clip(min=0) + (settings.read_noise or 0.0) ** 2)
        rates = values / self.seconds[:, None]
        corrections = corrections_of(settings.effects, self.manifest)
        for correction in corrections:
            inputs = range(self.manifest.inputs)
            correction.check(rates, self.manifest.frames, inputs, self.name)
        factors = correct(rates, corrections)
        return Estimate(values * factors.arrivals, values * factors.variance)

    def in_gates(self, frames: Estimate) -> Estimate:
        """Arrivals (E, f, inputs) of the masks' frames in their gates; clicks as they are."""
        masks = self.manifest.shown
        scale = (self.lengths_s / self.seconds[masks])[:, None]
        if self.settings.clicks is not None:
            scale = np.ones_like(scale)
        return Estimate(frames.arrivals[:, masks] * scale, frames.variance[:, masks] * scale**2)

    def as_ambient(self, sentinels: bool) -> Ambient:
        """Background that they measured with the scene dark, of scenes with sentinels or none."""
        if self.sentinels != sentinels:
            raise InputError(
                f"{self.name} must have all-ON and all-OFF frames if the other has, or none"
            )
        frames = self.correct()
        return Ambient.of(
            self.manifest,
            self.in_gates(frames),
            self.lengths_s,
            frames=frames.arrivals.sum(axis=0),
            frames_s=self.seconds * len(self.values) * sentinels,
        )


def _arrange(
    table: NumberTable, manifest: Manifest, settings: TableSettings, name: str
) -> np.ndarray:
    """Values (E, F, inputs), or without sentinels where there are none, by their names or shape."""
    names = column_names(manifest)
    inputs = manifest.inputs
    masks = names[2 * inputs : -2 * inputs]
    values = table.values
    columns = [column.lower() for column in table.names]
    if set(columns) & set(names):
        other = [column for column in table.names if column.lower() not in names]
        if other:
            raise InputError(
                f"{name} has a column {other[0]!r} that is no frame: "
                f"{closest_choice(other[0], names)}, and {' and '.join(TableSettings.WORDS)}"
            )
        missing = [column for column in names if column not in columns]
        if missing and set(missing) != {*names} - {*masks}:
            lacking = [column for column in missing if column in masks] or missing
            raise InputError(
                f"{name} has no column {lacking[0]!r}: give one for each of the masks' frames, "
                "and all of the all-ON and all-OFF frames or none"
            )
        order = [columns.index(column) for column in (masks if missing else names)]
        return values[:, order].reshape(len(values), -1, inputs)
    shape = dict(zip(("columns", "rows"), values.shape, strict=True))  # exposures along the other
    allowed = (len(masks), len(names))
    fits = {along: many in allowed for along, many in shape.items()}
    fits["columns"] &= not table.words
    if settings.exposures is None and all(fits.values()):
        raise InputError(
            "{name} has {columns} rows and {rows} columns, and either may be exposures: say "
            "{exposures} rows or columns",
            setting="exposures",
            name=name,
            columns=shape["columns"],
            rows=shape["rows"],
        )
    along = settings.exposures or ("rows" if fits["rows"] else "columns")
    if not fits[along]:
        asked = f", and exposures are its {along}" if settings.exposures else ""
        frames = f"{len(masks) // inputs} frames of masks"
        if inputs > 1:
            frames += f" x {inputs} inputs"
        raise InputError(
            f"{name} has {shape['columns']} rows and {shape['rows']} columns{asked}: an exposure "
            f"has {allowed[0]} values ({frames}), or {allowed[1]} with all ON and all OFF before "
            "and after them"
        )
    values = values.T if along == "columns" else values
    return values.reshape(len(values), -1, inputs)


def _find_scenes(
    table: NumberTable, exposures: int, settings: TableSettings, name: str
) -> tuple[tuple[Scene, ...], np.ndarray]:
    """Scenes, and which of them each exposure (E,) is of: those of one scene follow each other."""
    names = table.words.get(settings.SCENE)
    labels = table.words.get(settings.LABEL)
    repeats = settings.repeats
    if names is None:
        if exposures % repeats:
            raise InputError(f"{name} has {exposures} exposures, no multiple of {repeats} repeats")
        scene_of = np.arange(exposures) // repeats
        names = tuple(str(k + 1) for k in scene_of.tolist())
    else:
        if repeats > 1:
            raise InputError(
                "{name} names its scenes: leave {repeats} out", setting="repeats", name=name
            )
        changes = [a != b for a, b in zip(names[1:], names, strict=False)]
        scene_of = np.cumsum([0, *changes])
        if len(set(names)) <= scene_of[-1]:
            raise InputError(f"{name} has a scene twice, with others between: sort its rows")
    firsts = np.searchsorted(scene_of, np.arange(scene_of[-1] + 1)).tolist()
    scenes = (Scene(name=names[k], label=(labels[k] or None) if labels else None) for k in firsts)
    return tuple(scenes), scene_of


def _check_values(read: np.ndarray, manifest: Manifest, settings: TableSettings, name: str) -> None:
    """Raise `InputError` for too many values, and for photon counts or clicks that are none."""
    if read[:, 2:-2].size > MOST_READOUTS:
        raise InputError(f"{name} holds more than {MOST_READOUTS} values: split it")
    wrong = read[(read < 0) | (read % 1 != 0)]
    if wrong.size and not settings.analogue:
        raise InputError(
            f"{name} holds {wrong[0]:g}, which is no count of photons: give whole numbers, 0 or "
            "more, or --gain and --read-noise of an analogue detector"
        )
    most = settings.clicks
    if most is not None and (read > most).any():
        row, value = np.argwhere(read.reshape(len(read), -1) > most)[0].tolist()
        raise InputError(
            f"{name} has {read[row].ravel()[value]:g} counts in {column_names(manifest)[value]} of "
            f"exposure {row + 1}, and a detector of this design clicks at most {most} times in a "
            f"frame: give clicks from 0 to {most}"
        )


def _find_light(exposures: _Exposures, frames: Estimate, scene_of: np.ndarray) -> RunLight:
    """Light of each scene, all exposures of one together, from what arrived in all frames."""
    # scene_of (E,): scene of each exposure
    manifest = exposures.manifest
    settings = exposures.settings
    seconds = exposures.seconds
    scenes = int(scene_of[-1]) + 1
    arm = manifest.arm
    exposure_s = exposures.exposure_s
    stated = None if settings.background is None else settings.background / exposure_s
    dark = np.full((scenes, manifest.inputs), stated or 0.0)
    if not exposures.sentinels:
        return RunLight(
            on_rate=np.full(scenes, np.nan),
            off_rate=np.full(scenes, np.nan),
            flux=np.full(scenes, (settings.photons or np.nan) / exposure_s),
            dark_rate=manifest.by_rail(dark),
        )
    if settings.clicks is not None:
        clicks = frames.arrivals[:, ENDS]
        gates = np.full((len(clicks), len(ENDS), 1), settings.clicks)
        width = float(seconds[0]) / settings.clicks
        return light_of_clicks(
            clicks, clicks, gates, width_s=width, scenes=scenes, manifest=manifest
        )
    photons, variance = np.zeros((2, scenes, *frames.arrivals.shape[1:]))
    np.add.at(photons, scene_of, frames.arrivals)
    np.add.at(variance, scene_of, frames.variance)
    spent = np.bincount(scene_of)[:, None] * seconds
    on, off = (
        photons[:, ends].sum(axis=1) / spent[:, ends].sum(axis=1, keepdims=True)
        for ends in (ALL_ON, ALL_OFF)
    )
    if settings.analogue:
        measured = off.copy()
        measured[:, arm.stop :] = on[:, arm.stop :]  # the second arm is dark when all are ON
        measured[:] = measured.mean(axis=0)
        flux = np.full(scenes, (on - off)[:, arm].sum(axis=1).mean())
        faults: tuple[Fault, ...] = ()
    else:
        arrivals = Arrivals(
            manifest.frames,
            photons=photons[:, :, None],
            variance=variance[:, :, None],
            seconds=spent[..., None],
            middles=(np.cumsum(seconds) - seconds / 2)[:, None],
        )
        light = check_light(
            arrivals,
            manifest,
            range(manifest.inputs),
            scenes=np.arange(scenes),
            lost=np.empty(0, np.int64),
        )
        measured = light.dark_rate
        flux = light.flux
        faults = light.faults
    if stated is None:
        dark = measured
    return RunLight(
        on_rate=on[:, arm].sum(axis=1),
        off_rate=off[:, arm].sum(axis=1),
        flux=flux + (measured - dark)[:, arm].sum(axis=1),
        dark_rate=manifest.by_rail(dark),
        faults=faults,
    )


def table_of_series(
    values: np.ndarray,
    manifest: Manifest,
    *,
    bin_s: float | None = None,
    passes: int | None = None,
    name: str = "the file",
) -> tuple[np.ndarray, list[str]]:
    """Table of a counter that gives no events: cumulative counts at triggers, or even time bins."""
    inputs = manifest.inputs
    columns = values.T if values.shape[1] != inputs and values.shape[0] == inputs else values
    if columns.shape[1] != inputs:
        raise InputError(
            f"{name} has {values.shape[1]} columns, and these patterns have {inputs} inputs: give "
            "a column for each"
        )
    if (columns < 0).any() or (columns % 1 != 0).any() or columns.max() > 2.0**53:
        raise InputError(f"{name} holds what is no count: give whole numbers, 0 or more")
    counts = columns.astype(np.int64)
    if bin_s is None:
        return _of_cumulative(counts, manifest, passes, name)
    return _of_bins(counts, manifest, bin_s, passes=passes, name=name)


def _of_cumulative(
    counts: np.ndarray, manifest: Manifest, passes: int | None, name: str
) -> tuple[np.ndarray, list[str]]:
    """Rows of a table, and its columns, of counts (n, inputs) that a trigger latched."""
    # One latch at the start of each frame. With one more at the end of a pass the last frame has an
    # end and is counted; else the all-ON and all-OFF frames are left out
    frames = len(manifest.frames)
    names = column_names(manifest)
    fits = [
        latches
        for latches in (frames + 1, frames)
        if passes in (None, len(counts) / latches) and len(counts) % latches == 0
    ]
    if len(fits) != 1:
        raise InputError(
            "{name} has {count} cumulative counts, and a pass has {frames} frames, whose trigger "
            "gives as many, or one more at its end: "
            + ("say how many {passes} there are" if fits else "give those of whole passes"),
            setting="passes",
            name=name,
            count=len(counts),
            frames=frames,
        )
    steps = np.diff(counts.reshape(-1, fits[0], manifest.inputs), axis=1) % ROLL_OVER
    if (steps > ROLL_OVER / 2).any():
        raise InputError(
            f"{name} has counts that fall within a pass: give cumulative ones, in the order of "
            "their triggers"
        )
    if fits[0] > frames:
        return steps.reshape(len(steps), -1), names
    return steps[:, 2 : frames - 2].reshape(len(steps), -1), names[
        2 * manifest.inputs : -2 * manifest.inputs
    ]


def _of_bins(
    counts: np.ndarray, manifest: Manifest, bin_s: float, *, passes: int | None, name: str
) -> tuple[np.ndarray, list[str]]:
    """Rows of a table, and its columns, of counts (n, inputs) in even time bins."""
    lengths = manifest.picture_s / bin_s
    bins = np.rint(lengths).astype(np.int64)
    if abs(lengths - bins).max() > 1e-6 * max(lengths.max(), 1) or bins.min() < LEAST_BINS:
        times = sorted({round(one * 1e6) for one in manifest.picture_s.tolist()})
        raise InputError(
            f"pictures of {times[0]} to {times[-1]} µs are not whole numbers of bins of "
            f"{bin_s * 1e6:g} µs, {LEAST_BINS} or more: export an equal-dwell design or a scan "
            "with such a --dwell, or record in other bins"
        )
    total = np.concatenate([np.zeros((1, manifest.inputs), np.int64), counts.cumsum(axis=0)])
    places = np.array(sorted(_find_passes(total, bins, manifest, passes)), np.int64)
    if not len(places) or len(places) != (passes or len(places)):
        raise InputError(
            f"{name} has {len(places)} passes that begin and end with a bright and a dark frame"
            f"{'' if passes is None else f', and {passes} are asked for'}: give the patterns that "
            "were shown, and the length of the bins"
        )
    ends = places[:, None] + np.cumsum(bins)
    rows = total[ends] - total[ends - bins + 1]
    return rows.reshape(len(rows), -1), column_names(manifest)


def _find_passes(
    total: np.ndarray, bins: np.ndarray, manifest: Manifest, passes: int | None
) -> Iterator[int]:
    """First bins of passes, the surest first; `InputError` where a place is not certain."""
    # total (n + 1, inputs): counts before each bin
    length = int(bins.sum())
    starts = len(total) - length
    if starts < 1:
        return
    gain = _pass_gains(total, bins, manifest.arm)
    while passes is None or passes > 0:
        best = int(np.argmax(gain))
        if gain[best] == -np.inf:
            return
        near = slice(max(best - length + 1, 0), best + length)
        rivals = gain[near].copy()
        rivals[max(best - 1, 0) - near.start : best + 2 - near.start] = -np.inf
        if rivals.max() > gain[best] - CERTAIN_GAIN:
            raise InputError(
                f"a pass begins at bin {best} or {near.start + int(np.argmax(rivals))}, and the "
                "counts do not tell: use more light, or longer pictures"
            )
        gain[near] = -np.inf
        passes = None if passes is None else passes - 1
        yield best


def _pass_gains(total: np.ndarray, bins: np.ndarray, arm: slice) -> np.ndarray:
    """G (starts,) of a pass that begins at each bin; -inf where it cannot."""
    from scipy.special import xlogy

    starts = len(total) - int(bins.sum())
    gain = np.zeros(starts)
    single = np.diff(total, axis=0)
    saturated = np.concatenate([[0.0], xlogy(single, single).sum(axis=1).cumsum()])
    brightest = np.zeros(starts)
    ends = []  # counts of the arm in the all-ON and all-OFF frames, and the bins that they are of
    stops = zip(np.cumsum(bins).tolist(), (bins - 1).tolist(), strict=True)
    for frame, (stop, width) in enumerate(stops):
        counts = total[stop : stop + starts] - total[stop - width : stop - width + starts]
        gain += xlogy(counts, counts / width).sum(axis=1)
        gain -= saturated[stop : stop + starts] - saturated[stop - width : stop - width + starts]
        of_arm = counts[:, arm].sum(axis=1)
        if 2 <= frame < len(bins) - 2:  # kept as a maximum: all of these would not fit the memory
            least = of_arm / width - CERTAIN_SIGMAS * np.sqrt(of_arm) / width
            brightest = np.maximum(brightest, least)
        else:
            ends.append((of_arm, width))
    fits = np.ones(starts, bool)
    for (on, on_bins), (off, off_bins) in (ends[:2], ends[2:]):
        noise = np.sqrt(on / on_bins**2 + off / off_bins**2)
        fits &= on / on_bins - off / off_bins > CERTAIN_SIGMAS * noise
        fits &= on / on_bins + CERTAIN_SIGMAS * np.sqrt(on) / on_bins >= brightest
    return np.where(fits, gain, -np.inf)
