"""Series of a comparison: its points in groups, each with a name."""

from collections.abc import Iterable
from typing import Any, TypeAlias

from deepfsi.report.style import photons_text
from deepfsi.sweeps.results import Results

Measured: TypeAlias = Any
"""Accuracy of a design with its interval: a `Point`, or what has its names, as other cameras do."""

DESIGN_AND_OPTICS = ("design", "light", "rails", "detectors")
"""Fields that tell series apart in every comparison, the design first."""

_LONGEST_NAME = 32
"""Letters of the longest name in a figure; where one is longer, all are the designs' short ones."""

SeriesKey = tuple[str, ...]
"""Values of the fields that tell series apart."""


class Series:
    """Points by the fields that tell their series apart, in the order in which they appear."""

    def __init__(self, points: Iterable[Measured], axes: tuple[str, ...]) -> None:
        self.axes = axes
        self.groups: dict[SeriesKey, list[Measured]] = {}
        for point in points:
            self.groups.setdefault(self.key(point), []).append(point)

    @classmethod
    def of(cls, results: Results, points: Iterable[Measured] | None = None) -> "Series":
        """Series of some points of a comparison, all unless given."""
        return cls(results.points if points is None else points, series_axes(results))

    def key(self, point: Measured) -> SeriesKey:
        """Key of the series that a point is of."""
        return tuple(str(getattr(point, axis)) for axis in self.axes)

    def name(self, point: Measured, field: str = "title") -> str:
        """Name of a point's series: the design's, and other axes where these tell two apart."""
        key = self.key(point)
        kin = [other for other in self.groups if other[0] == key[0]]
        shares = shares_light(self.groups[key][0])  # their variant says so
        apart = [
            _axis_text(axis, getattr(self.groups[key][0], axis))
            for index, axis in enumerate(self.axes)
            if index
            and (len({other[index] for other in kin}) > 1 or (shares and axis == "variant"))
        ]
        return " ".join(filter(None, [getattr(self.groups[key][0], field), *apart]))

    def figure_names(self) -> dict[SeriesKey, str]:
        """Name of each series in a figure: written out, or short where one would be too long."""
        firsts = {key: members[0] for key, members in self.groups.items()}
        names = {key: self.name(point) for key, point in firsts.items()}
        if max(map(len, names.values())) <= _LONGEST_NAME:
            return names
        return {key: self.name(point, "label") for key, point in firsts.items()}


def series_axes(results: Results) -> tuple[str, ...]:
    """Fields that tell series apart, of those in which points differ beside noise and budget."""
    points = results.points
    apart = [axis for axis in ("variant", "levels") if len({getattr(p, axis) for p in points}) > 1]
    if "variant" not in apart and any(map(shares_light, points)):
        apart.append("variant")
    if any(p.trained_at != p.photons for p in points):
        apart.append("trained_at")
    pairs = {(p.noise, p.trained_under) for p in points}
    if len(pairs) > len({noise for noise, _ in pairs}):
        apart.append("trained_under")
    optics = {(p.light, p.rails, p.readout) for p in points}
    if len(optics) > len({(light, rails) for light, rails, _ in optics}):
        apart.append("readout")
    if results.chosen_on == "nothing":
        apart.append("masks")
    return (*DESIGN_AND_OPTICS, *apart)


def shares_light(point: Measured) -> bool:
    """True of exposures that stop when a class is sure, so that their budget is a mean."""
    return "mean_light" in getattr(point, "further", {})


def _axis_text(axis: str, value: Any) -> str:
    """Value of a field as a name of a series has it."""
    if axis == "levels":
        return f"{value} levels" if value else "continuous"
    if axis == "trained_at":
        return f"from {photons_text(value)}"
    if axis == "detectors":
        return f"{value} detectors"
    return f"from {value}" if axis == "trained_under" else str(value)


def noises(results: Results) -> list[str]:
    """Noise models of a comparison, in the order in which they appear."""
    return list(dict.fromkeys(point.noise for point in results.points))
