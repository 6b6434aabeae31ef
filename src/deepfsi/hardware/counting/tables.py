"""Counts of any counter: a table with a value for each frame and input becomes `Counts`.

A value is what the counter counted from one frame's marker to the next, or from `settle` after it.
Pictures last longer than their share of the exposure asks for, so the value of frame f, counted for
the time T_f, becomes that of its gate,

    value · share_f · E / T_f,      E = Σ T_f / Σ share_f  over the masks' frames,

and the budget is the flux times E: all the light of these frames.
"""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from deepfsi.base import InputError, Table, check_choice, closest_choice, time_text
from deepfsi.camera import NO_DEAD_TIME, DeadTime
from deepfsi.hardware.counting.acquisition import MOST_READOUTS, Scene
from deepfsi.hardware.counting.ambient import Ambient
from deepfsi.hardware.counting.clicks import (
    ENDS,
    check_budget_of_clicks,
    check_clicks,
    light_of_clicks,
    variance_of,
)
from deepfsi.hardware.counting.counts import Counts
from deepfsi.hardware.counting.rates import check_rates
from deepfsi.hardware.light import Arrivals, Fault, check_light
from deepfsi.hardware.patterns.sequence import Manifest

SCENE, LABEL = "scene", "label"
WORDS = (SCENE, LABEL)
"""Names of the columns of words."""

Along = Literal["rows", "columns"]
"""Exposures are the rows of a table, or its columns."""


@dataclass(frozen=True)
class TableSettings:
    """Settings with which a table is read; `InputError` if one of them is not allowed."""

    photons: float | None = None  # budget of an exposure; that of the all-ON frames unless given
    # Counts that an input has in the masks' frames of one exposure together without light; those of
    # the all-OFF frames unless given, and none without such frames
    background: float | None = None
    settle_s: float = 0.0  # time after each marker that was not counted, seconds
    exposures: str | None = None  # "rows" or "columns"; as the shape says unless given
    repeats: int = 1  # exposures of each scene, one after another, where the table names no scenes
    gain: float | None = None  # counts for a unit of the table, of an analogue detector
    read_noise: float | None = None  # of each value of an analogue detector, counts rms
    dead_time: DeadTime = NO_DEAD_TIME  # of a photon counter, to be corrected for
    # Exposures with the scene dark, whose counts are subtracted; a table as that of the others
    dark: Table | None = None
    # Gates of a frame, of tables of clicks: values from 0 to this
    clicks: int | None = None

    def __post_init__(self) -> None:
        if self.exposures is not None:
            check_choice("`exposures`", self.exposures, get_args(Along))
        for name, value in (("photons", self.photons), ("gain", self.gain)):
            if value is not None and not 0 < value < np.inf:
                raise InputError(f"`{name}` {value:g} is not allowed: give a number above 0")
        for name, value in (("background", self.background), ("read_noise", self.read_noise)):
            if value is not None and not 0 <= value < np.inf:
                raise InputError(f"`{name}` {value:g} is not allowed: give counts, 0 or more")
        if self.analogue and self.dead_time.seconds:
            raise InputError(
                "an analogue detector counts no photons: leave `dead_time` out, or `gain` and "
                "`read_noise`"
            )
        if self.repeats < 1:
            raise InputError(f"`repeats` {self.repeats} is not allowed: give 1 or more")
        if self.clicks is not None:
            of_photons = {
                "`background`": self.background is not None or self.dark is not None,
                "`dead_time`": bool(self.dead_time.seconds),
                "`gain` or `read_noise`": self.analogue,
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
    names, named = [], set()
    for frame in manifest.frames:
        name = frame.role
        if frame.role == "mask":
            sign = "" if manifest.rails == 1 or frame.rail == "both" else "+-"[frame.rail != "plus"]
            names.append(f"mask{frame.mask}{sign}")
        else:
            names.append(f"{name}2" if name in named else name)
            named.add(name)
    inputs = manifest.inputs
    if inputs == 1:
        return names
    return [f"{name}/{each}" for name in names for each in range(1, inputs + 1)]


def count_table(
    table: Table, manifest: Manifest, settings: TableSettings, name: str = "the table"
) -> tuple[Counts, tuple[Scene, ...]]:
    """Counts of the exposures in a table, and their scenes."""
    read, sentinels = _find_values(table, manifest, settings, name)
    scenes, place = _find_scenes(table, len(read), settings.repeats, name)
    _check_values(read, manifest, settings, name)
    times, shown = _find_times(manifest, settings.settle_s), manifest.shown
    exposure = float(times[shown].sum() / manifest.shares.sum())
    lengths = manifest.shares * exposure
    mean, variance = _correct(read, times, manifest, settings, name)
    light = _find_light(mean, variance, sentinels, place, times, exposure, manifest, settings)
    ambient = Ambient.none(manifest)
    if settings.dark is not None:
        ambient = _find_ambient(settings.dark, sentinels, times, lengths, manifest, settings)
        light["flux"] = ambient.of_flux(light["flux"], name)
    _check_budget(light, settings, name)
    repeats = np.bincount(place)
    valid = np.arange(repeats.max()) < repeats[:, None]
    scale = (lengths / times[shown])[:, None] if settings.clicks is None else 1.0

    def by_scene(frames: np.ndarray) -> np.ndarray:
        """Readouts (S, R, rails, m[, D]) from those of masks' frames (E, f, inputs)."""
        readouts = manifest.by_readout(frames)
        out = np.zeros((*valid.shape, *readouts.shape[1:]))
        out[valid] = readouts
        return out

    counts = Counts(
        **light,
        counts=by_scene(read[:, shown]),
        arrivals=by_scene(mean[:, shown] * scale),
        variance=by_scene(variance[:, shown] * scale**2),
        valid=valid,
        gate_s=lengths,
        exposure_s=exposure,
        settle_s=settings.settle_s,
        lengths_s=manifest.lengths_by_readout(lengths),
        drift=0.0,
        ambient=ambient.counts,
        ambient_variance=ambient.variance,
        inputs=tuple(range(manifest.inputs)),
        dead_time=settings.dead_time,
        gates=settings.clicks,
    )
    return counts, scenes


def _find_ambient(
    dark: Table,
    sentinels: bool,
    times: np.ndarray,
    lengths_s: np.ndarray,
    manifest: Manifest,
    settings: TableSettings,
) -> Ambient:
    """Background in a table of exposures with the scene dark."""
    # sentinels: whether the table of the scenes has all-ON and all-OFF frames; times (F,)
    name, shown = "the table of the background", manifest.shown
    read, known = _find_values(dark, manifest, settings, name)
    if known != sentinels:
        raise InputError(f"{name} must have all-ON and all-OFF frames if the other has, or none")
    _check_values(read, manifest, settings, name)
    mean, variance = _correct(read, times, manifest, settings, name)
    scale = (lengths_s / times[shown])[:, None]
    gates = mean[:, shown] * scale, variance[:, shown] * scale**2
    return Ambient.of(manifest, gates, (mean.sum(axis=0), times * len(read) * known), lengths_s)


def _correct(
    read: np.ndarray, times: np.ndarray, manifest: Manifest, settings: TableSettings, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Arrivals and their variance in all frames, of what was read (E, F, inputs) in times (F,)."""
    if settings.clicks is not None:
        return read, variance_of(read, settings.clicks)
    if settings.analogue:
        found = read * (settings.gain or 1.0)
        return found, found.clip(min=0) + (settings.read_noise or 0.0) ** 2
    rates, dead = read / times[:, None], settings.dead_time
    check_rates(dead, rates, manifest.frames, range(manifest.inputs), name)
    factors = dead.correction(rates)
    return read * factors.arrivals, read * factors.variance


def _find_times(manifest: Manifest, settle_s: float) -> np.ndarray:
    """For how long each frame is counted, seconds (F,), or `InputError` if one is not."""
    times = np.asarray(manifest.picture_s - settle_s)
    if times.min() <= 0:
        raise InputError(
            f"`settle` {time_text(settle_s)} leaves nothing of the shortest frame: give less than "
            f"{manifest.picture_s.min():g}"
        )
    return times


def _find_values(
    table: Table, manifest: Manifest, settings: TableSettings, name: str
) -> tuple[np.ndarray, bool]:
    """Values of all frames (E, F, inputs), and whether the table has sentinels; 0 where not."""
    names, inputs = column_names(manifest), manifest.inputs
    ends = 2 * inputs
    values, given = table.values, [each.lower() for each in table.names]
    known = [each for each in given if each in names]
    if known:
        _check_names(known, table.names, names, ends, name)
        wanted = names if len(known) == len(names) else names[ends:-ends]
        values = values[:, [given.index(each) for each in wanted]]
        along = "rows"
    else:
        along = _find_direction(table, names, inputs, settings, name)
    if along == "columns":
        values = values.T
    split = values.reshape(len(values), -1, inputs)
    if values.shape[1] == len(names):
        return split, True
    return np.pad(split, ((0, 0), (2, 2), (0, 0))), False


def _check_names(
    known: list[str], given: tuple[str, ...], names: list[str], ends: int, name: str
) -> None:
    """Raise `InputError` unless columns with names are those of all frames, or of all masks'."""
    other = [each for each in given if each.lower() not in names]
    if other:
        raise InputError(
            f"{name} has a column {other[0]!r} that is no frame: "
            f"{closest_choice(other[0], names)}, and {SCENE} and {LABEL}"
        )
    missing = [each for each in names if each not in known]
    sentinels = {*names[:ends], *names[-ends:]}
    if missing and set(missing) != sentinels:
        lacking = [each for each in missing if each not in sentinels] or missing
        raise InputError(
            f"{name} has no column {lacking[0]!r}: give one for each of the masks' frames, and "
            "all of the all-ON and all-OFF frames or none"
        )


def _find_direction(
    table: Table, names: list[str], inputs: int, settings: TableSettings, name: str
) -> str:
    """Exposures are a table's rows or its columns, by its shape or as the settings say."""
    frames = len(names) // inputs
    allowed = (len(names) - 4 * inputs, len(names))
    rows, columns = table.values.shape
    fits = {"rows": columns in allowed, "columns": rows in allowed and not table.words}
    along = settings.exposures
    if along is None and all(fits.values()):
        raise InputError(
            f"{name} has {rows} rows and {columns} columns, and either may be exposures: say "
            "`exposures` rows or columns"
        )
    chosen = along or next((each for each, fit in fits.items() if fit), None)
    if chosen is None or not fits[chosen]:
        each = f"{frames - 4} frames of masks" + (f" x {inputs} inputs" if inputs > 1 else "")
        raise InputError(
            f"{name} has {rows} rows and {columns} columns"
            + (f", and exposures are its {along}" if along else "")
            + f": an exposure has {allowed[0]} values ({each}), or {allowed[1]} with all ON and "
            "all OFF before and after them"
        )
    return chosen


def _find_scenes(
    table: Table, exposures: int, repeats: int, name: str
) -> tuple[tuple[Scene, ...], np.ndarray]:
    """Scenes, and which of them each exposure (E,) is of: those of one scene follow each other."""
    names, labels = table.words.get(SCENE), table.words.get(LABEL)
    if names is None:
        if exposures % repeats:
            raise InputError(f"{name} has {exposures} exposures, no multiple of {repeats} repeats")
        place = np.arange(exposures) // repeats
        names = tuple(str(k + 1) for k in place.tolist())
    else:
        if repeats > 1:
            raise InputError(f"{name} names its scenes: leave `repeats` out")
        changes = [a != b for a, b in zip(names[1:], names, strict=False)]
        place = np.cumsum([0, *changes])
        if len(set(names)) <= place[-1]:
            raise InputError(f"{name} has a scene twice, with others between: sort its rows")
    firsts = np.searchsorted(place, np.arange(place[-1] + 1)).tolist()
    scenes = (Scene(name=names[k], label=(labels[k] or None) if labels else None) for k in firsts)
    return tuple(scenes), place


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


def _find_light(
    mean: np.ndarray,
    variance: np.ndarray,
    sentinels: bool,
    place: np.ndarray,
    times: np.ndarray,
    exposure_s: float,
    manifest: Manifest,
    settings: TableSettings,
) -> dict[str, Any]:
    """Light of each scene as of `Counts`, all exposures of one together, from all frames."""
    # place (E,), the scene of each exposure; times (F,)
    scenes, arm = int(place[-1]) + 1, slice(0, manifest.detector_count)
    given = None if settings.background is None else settings.background / exposure_s
    dark = np.full((scenes, manifest.inputs), given or 0.0)
    if not sentinels:
        return {
            "on_rate": np.full(scenes, np.nan),
            "off_rate": np.full(scenes, np.nan),
            "flux": np.full(scenes, (settings.photons or np.nan) / exposure_s),
            "dark_rate": manifest.by_rail(dark),
            "faults": (),
        }
    if settings.clicks is not None:
        width = float(times[0]) / settings.clicks
        ends, gates = mean[:, ENDS], np.full((len(mean), len(ENDS), 1), settings.clicks)
        return light_of_clicks((ends, ends, gates), width, scenes, manifest)
    found, noise = np.zeros((2, scenes, *mean.shape[1:]))
    np.add.at(found, place, mean)
    np.add.at(noise, place, variance)
    seconds = np.bincount(place)[:, None] * times
    on, off = (
        found[:, frames].sum(axis=1) / seconds[:, frames].sum(axis=1, keepdims=True)
        for frames in ([0, -2], [1, -1])
    )
    faults: tuple[Fault, ...] = ()
    if settings.analogue:
        flux = np.full(scenes, (on - off)[:, arm].sum(axis=1).mean())
        measured = off.copy()
        measured[:, arm.stop :] = on[:, arm.stop :]  # the second arm is dark when all are ON
        measured[:] = measured.mean(axis=0)
    else:
        middles = (np.cumsum(times) - times / 2)[:, None]
        light = check_light(
            Arrivals(
                manifest.frames, found[:, :, None], noise[:, :, None], seconds[..., None], middles
            ),
            manifest,
            range(manifest.inputs),
            scenes=np.arange(scenes),
            lost=np.empty(0, np.int64),
        )
        flux, measured, faults = light.flux, light.dark_rate, light.faults
    if given is None:
        dark = measured
    return {
        "on_rate": on[:, arm].sum(axis=1),
        "off_rate": off[:, arm].sum(axis=1),
        "flux": flux + (measured - dark)[:, arm].sum(axis=1),
        "dark_rate": manifest.by_rail(dark),
        "faults": faults,
    }


def _check_budget(light: dict[str, Any], settings: TableSettings, name: str) -> None:
    """Raise `InputError` if nothing tells the budget."""
    if settings.photons is not None:
        return
    flux = light["flux"]
    if np.isnan(light["on_rate"]).all():
        raise InputError(
            f"{name} has no all-ON and all-OFF frames, which tell the budget: give `photons`"
        )
    if settings.clicks is not None:
        check_budget_of_clicks(flux, name)
    if not (flux > 0).any():
        raise InputError(
            f"{name} has no light: its all-ON frames are not brighter than the all-OFF ones; look "
            "at the order of frames, or give `photons`"
        )
