"""Pictures and a verdict on the light from tables of counts behind masks that are known."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from math import isqrt
from pathlib import Path
from typing import Any

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.numeric.arrays import split_variable
from deepfsi.base.numeric.tables import read_table
from deepfsi.base.quantities import plural
from deepfsi.hardware.pictures.rail_sums import (
    RailSums,
    check_rail_sums,
    fineness,
    range_text,
    split_rails,
)
from deepfsi.hardware.pictures.solve import (
    coarse_light,
    solve_masks,
    solve_wavelets,
    split_levels,
    wavelet_of,
)
from deepfsi.jobs.designs import FORMULAS, formula_masks
from deepfsi.jobs.mask_files import read_matrix

MEDIAN_OF_NORMAL = 0.6745
"""Median of the size of a standard normal number."""


@dataclass(frozen=True)
class TableMasks:
    """Masks that were shown, and the layout of tables of their counts."""

    masks: str  # name of a formula or of wavelets, or a file
    size: tuple[int, int] | None = None
    rails: str | None = None  # one of `LAYOUTS`; as the shape of the table says unless given
    exposures_s: tuple[float, ...] | None = None  # time of a picture, seconds, of each table
    block: int | None = None  # pictures that were shown at a time


@dataclass(frozen=True)
class Agreement:
    """Agreement of the pictures of some tables with that of another camera."""

    source: str  # where that is from
    reference: np.ndarray  # the other picture, by the line of best fit to the first table's
    tables: tuple[dict[str, float], ...]

    def lines(self, names: Sequence[str]) -> list[str]:
        """Say how well the pictures of tables with these names agree with it."""
        return [
            f"{name} beside {self.source}: correlation {table['correlation']:.3f}, residual "
            f"{table['residual']:.2f} of its contrast"
            for name, table in zip(names, self.tables, strict=True)
        ]


@dataclass(frozen=True)
class TablePictures:
    """Pictures from tables of counts, and what the counts say of the light."""

    names: tuple[str, ...]
    pictures: np.ndarray  # counts a pixel
    correlations: tuple[float, ...] = ()
    light: RailSums | None = None  # verdict on the light
    note: str = ""  # why there is none
    sums: np.ndarray | None = None  # rail sums, of pairs with an edge
    fine: np.ndarray | None = None  # fineness of their masks
    rates: tuple[float, ...] | None = None
    rate_errors: tuple[float, ...] | None = None
    on: tuple[float, ...] | None = None  # counts of all ON
    off: tuple[tuple[float, float, float], ...] | None = None
    uniform: tuple[float, ...] | None = None  # light of all ON and OFF over that of other pairs
    wavelets: tuple[dict[str, Any], ...] | None = None  # scatter of each table's coefficients
    agreement: Agreement | None = None  # with the picture of another camera

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON, without pictures; None for what is no number."""
        left = ("pictures", "sums", "fine", "light", "agreement")
        content = {name: value for name, value in vars(self).items() if name not in left}
        light = None if self.light is None else self.light.as_dict()
        agreement = () if self.agreement is None else self.agreement.tables
        plain: dict[str, Any] = _plain(content | {"light": light, "agreement": agreement})
        return plain

    @property
    def brightness(self) -> np.ndarray:
        """Divisors (tables, 1, 1) that bring pictures of several exposures to one brightness."""
        scale = np.abs(self.pictures).mean(axis=(1, 2), keepdims=True)
        return np.where((scale > 0) & (len(scale) > 1), scale, 1.0)

    def lines(self) -> Iterator[str]:
        """Say how the pictures agree, and what the counts say of the light."""
        shape = "x".join(map(str, self.pictures.shape[1:]))
        yield f"{plural(len(self.names), 'picture')} of {shape}"
        if self.correlations:
            yield f"pictures agree: correlation {range_text(self.correlations, '.2f')}"
        for name, scatter in zip(self.names, self.wavelets or (), strict=False):
            yield f"{name}: {scatter['measured']:.0%} of the coefficients were measured"
            if scatter["level"] and (ratio := scatter["variance_over_poisson"]):
                yield (
                    f"  details of level {scatter['level']} scatter with at most {min(ratio):.3g} "
                    f"to {max(ratio):.3g} times the variance of Poisson counts, if a unit of the "
                    "table were a count (tenths of like light)"
                )
        if self.note:
            yield f"note: {self.note}"
        if self.light is not None:
            yield from self.light.lines(self.names)
        if self.rates is not None and self.rate_errors is not None:
            mean = sum(self.rates) / len(self.rates)
            worst = max(abs(rate / mean - 1) for rate in self.rates)
            yield (
                f"mean picture: {range_text(self.rates, '.4g')} counts a second, {worst:.1%} from "
                f"their mean at most (photon noise {max(self.rate_errors):.2%})"
            )
        if self.on is not None and self.off is not None and self.uniform is not None:
            dark = ", ".join(f"{one:g} ({low:.1f} to {high:.1f})" for one, low, high in self.off)
            yield (f"all ON: {', '.join(f'{one:g}' for one in self.on)} counts; all OFF: {dark}")
            yield (
                f"all ON and all OFF together have {range_text(self.uniform, '.2f')} times the "
                "light of a mask and its inverse in the mean: 1 if no light is lost"
            )
        if self.agreement is not None:
            yield from self.agreement.lines(self.names)


def _plain(value: Any) -> Any:
    """Values as JSON holds them: no NaN."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return None if isinstance(value, float) and value != value else value


def read_pictures(sources: Sequence[str], settings: TableMasks) -> TablePictures:
    """Pictures of tables of counts, and the verdict on their light."""
    times = settings.exposures_s
    if times is not None and len(times) != len(sources):
        raise InputError(
            "{tables} tables and {count} {exposures}: give one time for each table",
            setting="exposures",
            tables=len(sources),
            count=len(times),
        )
    names = tuple(Path(source).name for source in sources)
    wavelet = wavelet_of(settings.masks)
    if wavelet is not None:
        return _of_wavelets(sources, names, *wavelet)
    values = [read_table(source).values for source in sources]
    masks, shape = _find_masks(values[0], settings, sources[0])
    runs = np.stack(
        [
            split_rails(table, settings.rails, len(masks), source)
            for table, source in zip(values, sources, strict=True)
        ]
    )
    weights, readouts = _as_read(masks, runs)
    pictures = solve_masks(weights, readouts).reshape(-1, *shape)
    light = _find_light(runs, weights, shape, settings.block)
    if times is not None:
        totals = runs.sum(axis=(1, 2))
        light["rates"] = tuple((totals / (runs[0].size * np.array(times))).tolist())
        light["rate_errors"] = tuple((np.maximum(totals, 1) ** -0.5).tolist())
    return TablePictures(names, pictures, _correlations(pictures), **light)


def _find_masks(
    table: np.ndarray, settings: TableMasks, name: str
) -> tuple[np.ndarray, tuple[int, int]]:
    """Masks (m, N) of settings, and the shape of a picture."""
    if settings.masks not in FORMULAS:
        if not split_variable(settings.masks)[0].exists():
            raise InputError(
                f"no masks {settings.masks!r}: give {', '.join(FORMULAS)}, wavelet-haar-4 and the "
                "like, or a file of masks (m, N) or (m, H, W)"
            )
        masks = read_matrix(settings.masks)
        masks = masks / np.abs(masks).max()  # the brightest cell is ON
        return masks, settings.size or _square(masks.shape[1], settings.masks)
    shape = settings.size
    if shape is None:
        rails = split_rails(table, settings.rails or _guess(table), None, name)
        shape = _square(rails.shape[1], name)
    masks = formula_masks(settings.masks, shape)
    if settings.rails is not None or min(table.shape) == 2:
        # A sequence may end before the formula does
        masks = masks[: split_rails(table, settings.rails, None, name).shape[1]]
    return masks, shape


def _guess(table: np.ndarray) -> str | None:
    """Masks alone, where a table of one column may have no inverses and is a square's."""
    return None if min(table.shape) > 1 or isqrt(table.size) ** 2 != table.size else "single"


def _square(pixels: int, name: str) -> tuple[int, int]:
    side = isqrt(pixels)
    if side**2 != pixels:
        raise InputError(
            "{name} is of {pixels} pixels, which are no square: give {size} HEIGHTxWIDTH, and "
            "{rails} of a table in one column",
            setting=("size", "rails"),
            name=name,
            pixels=pixels,
        )
    return side, side


def _as_read(masks: np.ndarray, runs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (m, N) of pixels in the readouts (runs, m) of runs (runs, rails, m)."""
    if runs.shape[1] == 2:
        # Of masks of 0 and 1 the inverse is 1 less the mask
        signed = masks if masks.min() < 0 else 2.0 * masks / masks.max() - 1.0
        return signed, runs[:, 0] - runs[:, 1]
    if not (masks.min() < 0 and _two_valued(masks)):
        return masks, runs[:, 0]
    # Where ±1 is shown as 1 and 0, twice a count is the signed readout and the light of all ON,
    # which a complete set has itself: its masks stay orthogonal
    on = np.flatnonzero((masks > 0).all(axis=1))
    if len(on) and len(masks) == masks.shape[1]:
        return masks, 2.0 * runs[:, 0] - runs[:, 0, on[:1]]
    return (masks > 0).astype(np.int8), runs[:, 0]


def _two_valued(masks: np.ndarray) -> bool:
    """True if each mirror is ON in a mask or in its inverse."""
    size = np.abs(masks)
    return bool(np.ptp(size) <= 1e-9 * size.max())


def _find_light(
    runs: np.ndarray, masks: np.ndarray, shape: tuple[int, ...], block: int | None
) -> dict[str, Any]:
    """Rail sums and their verdict as of `TablePictures`."""
    wrong = runs[(runs < 0) | (runs % 1 != 0)]
    if wrong.size:
        return {"note": f"values such as {wrong[0]:g} are no counts: nothing is said of the light"}
    if runs.shape[1] == 1:
        return {"note": "masks without inverses: their counts have no mean in common"}
    if not _two_valued(masks):
        return {"note": "a mirror is ON in neither of some pairs: rail sums are not of one light"}
    fine = fineness(masks, shape)
    edged = fine.any(axis=1)
    sums = runs.sum(axis=1)[:, edged]
    found: dict[str, Any] = {"sums": sums, "fine": fine[edged]}
    if (~edged).any():
        flat = runs[:, :, ~edged].sum(axis=2) / (~edged).sum()
        on = flat.max(axis=1)
        off = flat.min(axis=1)
        found["on"] = tuple(on.tolist())
        found["off"] = tuple((float(one), *_poisson_interval(one)) for one in off)
        found["uniform"] = tuple(((on + off) / sums.mean(axis=1)).tolist())
    light = check_rail_sums(runs[:, :, edged], fine[edged], np.flatnonzero(edged), block)
    found["light"] = light
    if light is None:
        found["note"] = "too few pairs or counts for a verdict on the light"
    return found


def _poisson_interval(count: float) -> tuple[float, float]:
    """Exact 95 % interval of a Poisson mean from its count."""
    from scipy.special import gammaincinv

    low = float(gammaincinv(count, 0.025)) if count > 0 else 0.0
    return low, float(gammaincinv(count + 1, 0.975))


def _correlations(pictures: np.ndarray) -> tuple[float, ...]:
    """Correlation of two pictures each."""
    flat = pictures.reshape(len(pictures), -1)
    return tuple(float(np.corrcoef(a, b)[0, 1]) for a, b in combinations(flat, 2))


def compare_picture(pictures: TablePictures, source: str) -> TablePictures:
    """Compare pictures with that of another camera; they then have their agreement with it."""
    reference = read_table(source).values
    if reference.shape != pictures.pictures.shape[1:]:
        raise InputError(
            f"{source} has shape {reference.shape}, and pictures have "
            f"{pictures.pictures.shape[1:]}: give a picture of the same shape"
        )
    lines = []
    agreement = []
    for picture in pictures.pictures:
        slope, offset = np.polyfit(reference.ravel(), picture.ravel(), 1)
        lines.append(slope * reference + offset)
        rest = picture - lines[-1]
        r = float(np.corrcoef(picture.ravel(), reference.ravel())[0, 1])
        agreement.append(
            {"correlation": r, "residual": float(rest.std() / abs(slope) / reference.std())}
        )
    return replace(pictures, agreement=Agreement(source, lines[0], tuple(agreement)))


def _of_wavelets(
    sources: Sequence[str], names: tuple[str, ...], wavelet: str, levels: int
) -> TablePictures:
    """Pictures of wavelet coefficients, and what these say of their noise."""
    pictures = []
    scatters = []
    for source in sources:
        values = read_table(source).values
        picture, reverse = solve_wavelets(values, wavelet, levels)
        pictures.append(picture)
        scatters.append(_wavelet_noise(values, wavelet, levels) | {"reversed": reverse})
    if len({picture.shape for picture in pictures}) > 1:
        raise InputError("tables of coefficients have several shapes: give those of one shape")
    every = np.stack(pictures)
    note = (
        "only differences of two counts are in the table: their scatter is bounded from above, and "
        "whether the counts are Poisson cannot be said"
    )
    return TablePictures(names, every, _correlations(every), note=note, wavelets=tuple(scatters))


def _wavelet_noise(values: np.ndarray, wavelet: str, levels: int) -> dict[str, Any]:
    """Scatter of the diagonal details of the finest level that was measured, against Poisson's."""
    # y⁺ + y⁻ of a detail is the light of its support, in the unit of the table: the mean of its
    # level and place (of Haar exactly). The median of |W| where the light is alike bounds the
    # noise from above, as edges of the scene add to it
    parts = split_levels(values, levels)
    measured = [level for level in range(1, levels + 1) if any(map(np.any, parts[-level]))]
    found: dict[str, Any] = {"measured": float(np.count_nonzero(values) / values.size)}
    if not measured:
        return found | {"level": None}
    level = measured[0]
    light = coarse_light(parts[: levels - level + 1], wavelet).ravel()
    details = parts[-level][2]
    tenths = np.array_split(np.argsort(light), 10)
    scatter = [
        float(np.median(np.abs(details.ravel()[each])) / MEDIAN_OF_NORMAL) for each in tenths
    ]
    bright = [float(light[each].mean()) for each in tenths]
    ratio = [noise**2 / mean for noise, mean in zip(scatter, bright, strict=True) if mean > 0]
    return found | {
        "level": level,
        "light": bright,
        "scatter": scatter,
        "variance_over_poisson": ratio,
    }
