"""The folder of a recording: what was shown and recorded, and photons counted frame by frame.

    acquisition.json   scenes, exposure, settle time (`Acquisition`)
    patterns/          manifest.json, mirrors.npy and the design of the patterns shown, no frames
    photons.ptu        photons and frame markers, as the vendor's software or a virtual camera wrote
    counts.npz         photons of each readout (`Counts`), written by `count`
    calibration/       spot scans and flat fields, if there are any

Markers say when frames start; photons are counted in windows of these; the counts are corrected for
what the counter does, and the light is checked. A recording can be counted again for another
exposure: gates are shorter or longer, and as many follow each other in a frame as there are
repeats.
"""

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from shutil import copyfile
from typing import Any, Self

import numpy as np

from deepfsi.base.errors import InputError, as_input_error, check_choice
from deepfsi.base.files import hash_file, new_folder, read_regular, read_text, write_atomically
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import count_text, time_text
from deepfsi.camera.dead_time import NO_DEAD_TIME, DeadTime
from deepfsi.counting.acquisition import Acquisition, Calibration
from deepfsi.counting.checks import Fault, check_light, find_lateness
from deepfsi.counting.counts import (
    ALL_OFF,
    ALL_ON,
    ENDS,
    Ambient,
    Corrections,
    Counts,
    Estimate,
    RunLight,
    check_clicks,
    light_of_clicks,
)
from deepfsi.counting.flux import Arrivals, name_inputs
from deepfsi.counting.reader import PhotonSource, PtuFile, summarise
from deepfsi.counting.windows import (
    MOST_DRIFT,
    FrameStarts,
    WindowCounts,
    Windows,
)
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.manifest import GatePlan, Manifest


@dataclass(frozen=True)
class CountSettings:
    """Settings with which a recording is counted; its acquisition gives what is None."""

    exposure_s: float | None = None
    settle_s: float | None = None
    repeats: int | None = None  # gates in each frame
    tolerance_s: float | None = None  # by how much a marker may be off, seconds
    inputs: tuple[int, ...] | None = None  # inputs of the counter, from 0, one for each detector
    marker_bit: int | None = None  # 1, 2, 4 or 8: the marker input of the device's trigger
    dead_time: DeadTime | None = None  # to be corrected for
    background: str | None = None  # name of a dark scene
    gains: tuple[float, ...] = ()
    clicks: int | None = None


@dataclass(frozen=True)
class Recording:
    """Folder of a recording: its settings, and the patterns that were shown."""

    folder: Path
    acquisition: Acquisition
    patterns: Patterns

    @classmethod
    def prepare(
        cls,
        folder: str | os.PathLike[str],
        patterns: Patterns,
        acquisition: Acquisition,
        photons: Path | None = None,
    ) -> Self:
        """Make the folder of a recording, with a copy of its photon file if it has one."""
        source = patterns.folder
        assert source is not None
        names = ["manifest.json", "mirrors.npy"]
        if patterns.manifest.design_sha256:
            names.append(Patterns.DESIGN)
        content = {
            name: read_regular(source / name, 2**32, "export the patterns again") for name in names
        }
        digest = sha256(content["manifest.json"]).hexdigest()
        if acquisition.manifest_sha256 not in (None, digest):
            raise InputError(f"the acquisition is of other patterns than those in {source}")
        acquisition = acquisition.model_copy(update={"manifest_sha256": digest})
        acquisition.check(patterns.manifest, "the acquisition")
        with new_folder(folder) as draft:
            (draft / "calibration").mkdir()
            (draft / "patterns").mkdir()
            for name, data in content.items():
                (draft / "patterns" / name).write_bytes(data)
            (draft / "acquisition.json").write_bytes(acquisition.model_dump_json(indent=1).encode())
            if photons is not None:
                copyfile(photons, draft / "photons.ptu")
        return cls(Path(folder), acquisition, patterns)

    @classmethod
    def read(cls, folder: str | os.PathLike[str]) -> Self:
        """Settings and patterns of a recording, or `InputError` where they do not fit."""
        path = Path(folder) / "acquisition.json"
        prepare = "make the folder with `deepfsi camera import` or `simulate`"
        content = read_text(path, 2**24, prepare)
        with as_input_error(str(path), content=content):
            acquisition = Acquisition.model_validate_json(content)
        patterns = Patterns.read(path.parent / "patterns")
        manifest = path.parent / "patterns" / "manifest.json"
        if hash_file(manifest) != acquisition.manifest_sha256:
            raise InputError(
                f"{manifest} is not the one that {path} was made with: copy the patterns that were "
                f"shown, or {prepare}"
            )
        acquisition.check(patterns.manifest, str(path))
        return cls(Path(folder), acquisition, patterns)

    @property
    def manifest(self) -> Manifest:
        """Frames in the order in which they were shown."""
        return self.patterns.manifest

    @property
    def photons(self) -> Path:
        """File of the photons and markers."""
        return self.folder / "photons.ptu"

    def open_photons(self) -> PtuFile:
        """Photons of a counter with enough inputs for the detectors, or `InputError`."""
        source = PtuFile(self.photons)
        header = source.header
        self.manifest.check_inputs(header.kind.inputs, f"{header.path} ({header.kind.name})")
        return source

    def keep_first(self, scenes: int) -> None:
        """Write to the folder of a run that was stopped that it has its first scenes alone."""
        kept = self.acquisition.model_copy(update={"scenes": self.acquisition.scenes[:scenes]})
        content = kept.model_dump_json(indent=1).encode()
        write_atomically(self.folder / "acquisition.json", content)

    def count(
        self, settings: CountSettings | None = None, *, progress: Progress = SILENT
    ) -> Counts:
        """Count the photons of each readout, and write counts.npz.

        Parameters
        ----------
        settings : CountSettings, optional
            Exposure, wiring and corrections, where they are others than the acquisition's.
        progress : Progress
            Told how much is read.

        Raises
        ------
        InputError
            If the photon file is missing or damaged, gates do not fit the frames, markers do not
            follow the schedule, or no pass has light.
        """
        settings = settings or CountSettings()
        self.acquisition.check_fixed(self.folder)
        wired = replace(
            self, acquisition=self.acquisition.rewired(settings.inputs, settings.marker_bit)
        )
        gates = self.acquisition.gates(
            self.manifest, settings.exposure_s, settings.settle_s, settings.repeats
        )
        if settings.clicks is not None:
            refused = {
                "dead time": settings.dead_time is not None,
                "a background": settings.background is not None,
                "a flat field": bool(settings.gains),
            }
            check_clicks(settings.clicks, refused)
        self._check_click_gates(gates, settings.clicks)
        if settings.clicks is None:
            counts = _count_photons(wired, gates, settings, progress)
        else:
            gates = gates.with_clicks(self.manifest, settings.clicks)
            counts = _count_clicks(wired, gates, settings, progress)
        counts.save(self._counts_file, self.photons, self.acquisition.digest)
        return counts

    def _check_click_gates(self, gates: GatePlan, clicks: int | None) -> None:
        """Raise `InputError` unless a recording of a gated detector is counted in its gates."""
        recorded = (self.acquisition.camera or {}).get("gates")
        if not recorded:
            return
        planned = self.acquisition.gates(self.manifest)
        same = np.array_equal(gates.length_s, planned.length_s)
        if recorded != clicks or not same or gates.settle_s != planned.settle_s:
            raise InputError(
                f"{self.folder} holds the first photons alone of {recorded} gates in "
                f"{time_text(self.acquisition.exposure_s)}: count these gates, of that exposure "
                "and settle time, or record again"
            )

    def read_counts(self) -> Counts:
        """Counts that `count` wrote; `InputError` if settings or photons changed since."""
        self.acquisition.check_fixed(self.folder)
        return Counts.read(self._counts_file, self.photons, self.acquisition.digest)

    @property
    def _counts_file(self) -> Path:
        return self.folder / "counts.npz"

    def as_dict(self, counts: Counts) -> dict[str, Any]:
        """JSON types only: its counts, and faults with the names of scenes."""
        names = [scene.name for scene in self.acquisition.scenes]
        faults = [
            fault.model_dump() | {"name": None if fault.scene is None else names[fault.scene]}
            for fault in counts.faults
        ]
        return {
            "scenes": len(counts.counts),
            "exposures": int(counts.valid.size),
            "whole": int(counts.valid.sum()),
            "exposure_s": counts.exposure_s,
            "photons_counted": int(counts.counts.sum()),
            "photons": [None if math.isnan(flux) else flux for flux in counts.photons.tolist()],
            "dark_rate": counts.dark_rate.tolist(),
            "drift": counts.drift,
            "inputs": [number + 1 for number in counts.inputs],
            "dead_time_s": counts.dead_time.seconds,
            "paralysable": counts.dead_time.paralysable,
            "arrivals": float(counts.arrivals.sum()),
            "ambient": float(counts.ambient.sum()),
            "gains": list(counts.gains),
            "gates": counts.gates,
            "problems": list(PtuFile(self.photons).header.problems),
            "faults": faults,
            "counts": counts.counts.tolist(),
            "valid": counts.valid.tolist(),
        }

    def lines(self, counts: Counts) -> Iterator[str]:
        """Say what was counted, its faults, and what was corrected."""
        for problem in PtuFile(self.photons).header.problems:
            yield f"{self.photons.name}: {problem}"
        names = [scene.name for scene in self.acquisition.scenes]
        for fault in counts.faults:
            yield fault.words(names)
        counted = int(counts.counts.sum())
        if counts.dead_time.seconds:
            lost = 1 - counted / max(float(counts.arrivals.sum()), 1.0)
            yield (
                f"dead time of {counts.dead_time}: {lost:.1%} of the photons were lost, "
                "and are added"
            )
        if counts.gains:
            gains = ", ".join(f"{gain:.3f}" for gain in counts.gains)
            yield f"efficiencies corrected: {gains}"
        kind = "photons" if counts.gates is None else f"clicks of up to {counts.gates} a frame"
        stated = counts.gates is not None and self.acquisition.flux in counts.flux
        source = "that acquisition.json states" if stated else "by the all-ON frames"
        yield (
            f"{len(counts.counts)} scenes, {counts.valid.size} exposures of "
            f"{time_text(counts.exposure_s)}, {int(counts.valid.sum())} of them whole"
        )
        yield f"{counted} {kind} counted"
        yield f"budget {source}: {_span(counts.photons)} photons an exposure"
        yield f"dark counts: {_span(counts.dark_rate[counts.valid.any(axis=1)])} a second"
        yield f"clocks: frames last {1 + counts.drift:.7g} times as long as planned"
        if counts.ambient_variance.any():
            error = math.sqrt(counts.ambient_variance.sum())
            found = f"{counts.ambient.sum():.4g} ± {error:.2g}"
            yield f"background subtracted: {found} counts an exposure"
        yield f"counts: {self._counts_file}"


def _span(values: np.ndarray) -> str:
    """Least and largest of the numbers among some."""
    if np.isnan(values).all():
        return "unknown"
    ends = [count_text(end) for end in (np.nanmin(values), np.nanmax(values))]
    return " to ".join(dict.fromkeys(ends))


@dataclass(frozen=True)
class _FoundFrames:
    """Photons of a recording whose frames were found, and the gates in which they are counted."""

    recording: Recording
    source: PhotonSource
    gates: GatePlan
    starts: FrameStarts

    @classmethod
    def of(
        cls,
        recording: Recording,
        gates: GatePlan,
        tolerance_s: float | None = None,
        progress: Progress = SILENT,
    ) -> Self:
        """Find the frames of a recording, whose counter must resolve the shortest gate."""
        manifest = recording.manifest
        source = recording.open_photons()
        tick_s = source.header.tick_s
        shortest = (gates.click_width_s if gates.clicks else gates.length_s).min()
        # Ticks of the counter that a gate must have at least
        if shortest < 10 * tick_s:
            raise InputError(
                f"{recording.photons} has times in steps of {time_text(tick_s)}, too coarse for "
                f"gates of {time_text(shortest)}: give a longer exposure"
            )
        starts = FrameStarts.find(
            source, recording.acquisition, manifest, tolerance_s, progress=progress
        )
        # Frames may be so much shorter than planned that gates do not fit
        pictures = starts.pictures_s[manifest.shown]
        room = pictures - gates.settle_s
        over = gates.repeats * gates.length_s - room - MOST_DRIFT * pictures
        if over.max() > 0:
            exposure = float((room / manifest.shares).min()) / gates.repeats
            raise InputError(
                f"{recording.photons} has frames {-starts.drift:.2%} shorter than planned, and "
                f"{gates.repeats} exposures do not fit: give --exposure {exposure:.4g} or less, or "
                "fewer --repeats"
            )
        return cls(recording, source, gates, starts)

    def count_in(self, windows: Windows, progress: Progress = SILENT) -> WindowCounts:
        """Photons of the passes in windows."""
        inputs = self.recording.acquisition.inputs
        return self.starts.count_in(self.source, windows, inputs, progress)

    def check_lit(self, lit: np.ndarray, *, inverted: bool = False) -> None:
        """Raise `InputError` if no pass has light, saying which inputs have photons."""
        if lit.any():
            return
        if inverted:
            raise InputError(
                f"{self.recording.photons} has bright all-OFF frames and dark all-ON ones: the "
                "mirrors are inverted, or a marker is missing at one end and another is extra; "
                "export the patterns again with --invert, or give the inputs of the arms in the "
                "other order"
            )
        photons = sorted(summarise(self.source).photons.items())
        there = ", ".join(f"{number} photons on input {k + 1}" for k, number in photons)
        inputs = name_inputs(self.recording.acquisition.inputs)
        raise InputError(
            f"{self.recording.photons} has no light on input {inputs}: no all-ON frame is brighter "
            f"than the all-OFF ones. The file holds {there or 'no photons'}: give the input that "
            "the detector is wired to and the patterns that were shown, or switch on the lamp"
        )

    def find_ambient(self, gated: WindowCounts, corrections: Corrections) -> Ambient:
        """Background of passes with the scene dark."""
        manifest = self.recording.manifest
        photons, spent = gated.per_frame()
        factors = corrections.factors(photons / spent[..., None])
        estimate = Estimate.of(gated.gates(self.gates.repeats), factors, manifest)
        return Ambient.of(
            manifest,
            Estimate(*(one.reshape(-1, *one.shape[2:]) for one in vars(estimate).values())),
            self.gates.length_s,
            frames=(photons * factors.arrivals).sum(axis=0),
            frames_s=spent.sum(axis=0),
        )

    def counts(
        self, passes: np.ndarray, readouts: Estimate, light: RunLight, **others: Any
    ) -> Counts:
        """Counts of all scenes, from readouts and light of passes (P,)."""
        scenes = len(self.recording.acquisition.scenes)
        fields: dict[str, Any] = vars(readouts) | vars(light) | others
        for name in ("counts", "arrivals", "variance", "on_rate", "off_rate", "flux", "dark_rate"):
            some = fields[name]
            lost = np.nan if name in ("on_rate", "off_rate", "flux") else 0
            fields[name] = np.full((scenes, *some.shape[1:]), lost, some.dtype)
            fields[name][passes] = some
        valid = np.isin(np.arange(scenes), passes)
        return Counts(
            **fields,
            valid=np.repeat(valid[:, None], self.gates.repeats, axis=1),
            gate_s=self.gates.length_s,
            settle_s=self.gates.settle_s,
            lengths_s=self.recording.manifest.lengths_by_readout(self.gates.length_s),
            drift=self.starts.drift,
            inputs=self.recording.acquisition.inputs,
        )


def _count_photons(
    recording: Recording, gates: GatePlan, settings: CountSettings, progress: Progress
) -> Counts:
    """Photons of each readout, and what arrived, corrected and less no background yet."""
    manifest = recording.manifest
    acquisition = recording.acquisition
    dead_time = settings.dead_time
    calibration = recording.folder / "calibration"
    if dead_time is None and (calibration / "calibration.json").is_file():
        dead_time = Calibration.load(calibration).dead_time
    dead_time = dead_time or NO_DEAD_TIME
    corrections = Corrections.of(dead_time, manifest, settings.gains)
    ambient = Ambient.none(manifest)
    names = [scene.name for scene in acquisition.scenes]
    if settings.background is not None:
        check_choice("scene", settings.background, names)
    found = _FoundFrames.of(recording, gates, settings.tolerance_s, progress.between(0.0, 0.4))
    source = str(recording.photons)
    gated = found.count_in(
        Windows.of_gates(manifest, gates, found.starts), progress.between(0.4, 1.0)
    )
    of_dark = []
    passes = np.arange(len(names))
    if settings.background is not None:
        dark = names.index(settings.background)
        others = passes != dark
        passes = passes[others]
        ambient = found.find_ambient(gated.select(~others), corrections)
        gated = gated.select(others)
        detail = "it was dark, and its counts are subtracted from those of the others"
        of_dark.append(Fault(kind="background", scene=dark, detail=detail))
    photons, spent = gated.per_frame()
    rates = photons / spent[..., None]
    corrections.check(rates, manifest.frames, acquisition.inputs, source)
    factors = corrections.factors(rates)
    arrivals = Arrivals(
        manifest.frames,
        photons=photons * factors.arrivals,
        variance=photons * factors.variance,
        seconds=spent,
    )
    light = check_light(arrivals, manifest, acquisition.inputs, scenes=passes)
    on, off = (
        (rates * factors.arrivals)[:, frames].mean(axis=1)[:, manifest.arm].sum(axis=1)
        for frames in (ALL_ON, ALL_OFF)
    )
    late = find_lateness(*gated.around_first_mask(manifest.arm))
    found.check_lit(light.lit, inverted=off.sum() > 2 * on.sum())
    counts = gated.gates(gates.repeats)
    return found.counts(
        passes,
        Estimate.of(counts, factors, manifest).by_readout(manifest),
        RunLight(
            on_rate=on,
            off_rate=off,
            flux=ambient.of_flux(light.flux, source),
            dark_rate=manifest.by_rail(light.dark_rate),
            faults=(*late, *light.faults, *of_dark),
        ),
        counts=manifest.by_readout(counts),
        exposure_s=settings.exposure_s or acquisition.exposure_s,
        ambient=ambient.counts,
        ambient_variance=ambient.variance,
        dead_time=dead_time,
        gains=settings.gains,
    )


def _count_clicks(
    recording: Recording, gates: GatePlan, settings: CountSettings, progress: Progress
) -> Counts:
    """Clicks of each readout: the first photon of each gate of an exposure."""
    manifest = recording.manifest
    acquisition = recording.acquisition
    found = _FoundFrames.of(recording, gates, settings.tolerance_s, progress.between(0.0, 0.4))
    windows = Windows.of_clicks(gates, len(acquisition.scenes))
    gated = found.count_in(windows, progress.between(0.4, 1.0))
    found.check_lit(gated.photons)
    whole = found.count_in(Windows.of_gates(manifest, gates, found.starts))
    late = find_lateness(*whole.around_first_mask(manifest.arm))
    fired = np.minimum(gated.photons, 1)
    opened = (gated.open_s > 0)[..., None]
    clicks = manifest.by_readout(_sum_exposures(fired, gates, manifest.shown, gates.repeats))
    light = light_of_clicks(
        *(
            _sum_exposures(values, gates, np.array(ENDS), 1)[:, 0]
            for values in (gated.photons, fired, opened)
        ),
        width_s=float(gates.click_width_s[0]),
        scenes=len(acquisition.scenes),
        manifest=manifest,
    )
    # Where clicks do not tell the flux, it is the one that was stated
    flux = np.where(np.isfinite(light.flux), light.flux, acquisition.flux or np.nan)
    ambient = Ambient.none(manifest)
    return found.counts(
        np.arange(len(acquisition.scenes)),
        Estimate(clicks.astype(float), clicks * (1 - clicks / gates.clicks)),
        replace(light, flux=flux, faults=late),
        counts=clicks,
        exposure_s=settings.exposure_s or acquisition.exposure_s,
        ambient=ambient.counts,
        ambient_variance=ambient.variance,
        gates=gates.clicks,
    )


def _sum_exposures(
    values: np.ndarray, gates: GatePlan, frames: np.ndarray, repeats: int
) -> np.ndarray:
    """Sums (P, R, f, inputs), over exposures of frames (f,), of gates' values (P, g, inputs)."""
    first = (np.cumsum(gates.click_exposures) - gates.click_exposures)[frames]
    sums = values.reshape(len(values), -1, gates.clicks, values.shape[-1]).sum(axis=2)
    return np.asarray(sums[:, first + np.arange(repeats)[:, None]])
