"""A run counted: from its photons to the counts of each readout.

Markers say when frames start; photons are counted in windows of these; the counts are corrected for
what the counter does, and the light is checked. All of it can be done again for another exposure.
"""

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import time_text
from deepfsi.camera.dead_time import NO_EFFECTS, CounterEffects
from deepfsi.hardware.counting.acquisition import Calibration, Run, read_run
from deepfsi.hardware.counting.corrections import (
    ALL_OFF,
    ALL_ON,
    ENDS,
    Ambient,
    Corrections,
    Estimate,
    check_clicks,
    light_of_clicks,
    variance_of_clicks,
)
from deepfsi.hardware.counting.counts import Counts, RunLight
from deepfsi.hardware.counting.windows import (
    MOST_DRIFT,
    FrameStarts,
    WindowCounts,
    Windows,
    count_in_windows,
    find_frames,
    sum_exposures,
)
from deepfsi.hardware.light.checks import Fault, check_light, find_lateness
from deepfsi.hardware.light.curves import PARTS_OF_FRAME, Arrivals, name_inputs
from deepfsi.hardware.patterns.folder import GatePlan
from deepfsi.hardware.photons.reader import PhotonSource, summarise


@dataclass(frozen=True)
class CountSettings:
    """Settings with which a run is counted; what is not given is as it was recorded."""

    exposure_s: float | None = None
    settle_s: float | None = None
    repeats: int | None = None  # gates in each frame
    tolerance_s: float | None = None  # by how much a marker may be off, seconds
    inputs: tuple[int, ...] | None = None  # inputs of the counter, from 0, one for each detector
    marker_bit: int | None = None  # 1, 2, 4 or 8: the marker input of the device's trigger
    effects: CounterEffects | None = None  # to be corrected for
    background: str | None = None
    gains: tuple[float, ...] = ()
    clicks: int | None = None


def count_run(
    folder: str | os.PathLike[str],
    settings: CountSettings | None = None,
    *,
    progress: Progress = SILENT,
) -> Counts:
    """Count the photons of each readout and write counts.npz.

    Parameters
    ----------
    folder : str or path
        Of the run.
    settings : CountSettings, optional
        As it was recorded unless given.
    progress : Progress

    Returns
    -------
    Counts

    Raises
    ------
    InputError
        If files are missing or damaged, gates do not fit the frames, markers do not follow the
        schedule, or no pass has light.
    """
    settings = settings or CountSettings()
    recorded = read_run(folder)
    recorded.acquisition.check_fixed(folder)
    wiring = recorded.acquisition.rewired(settings.inputs, settings.marker_bit)
    run = replace(recorded, acquisition=wiring)
    gates = run.acquisition.gates(
        run.manifest, settings.exposure_s, settings.settle_s, settings.repeats
    )
    click_gates = (run.acquisition.camera or {}).get("gates")  # of a gated detector
    planned = run.acquisition.gates(run.manifest) if click_gates else gates
    same = np.array_equal(gates.length_s, planned.length_s) and gates.settle_s == planned.settle_s
    if click_gates and (click_gates != settings.clicks or not same):
        raise InputError(
            f"{folder} holds the first photons alone of {click_gates} gates in "
            f"{time_text(run.acquisition.exposure_s)}: count these gates, of that exposure and "
            "settle time, or record again"
        )
    if settings.clicks is None:
        counts = _count_photons(run, gates, settings, progress)
    else:
        of_photons = {
            "dead time": settings.effects is not None,
            "a background": settings.background is not None,
            "a flat field": bool(settings.gains),
        }
        check_clicks(settings.clicks, of_photons)
        gates = gates.with_clicks(run.manifest, settings.clicks)
        counts = _count_clicks(run, gates, settings, progress)
    counts.save(recorded)
    return counts


@dataclass(frozen=True)
class _Recording:
    """Photons of a run, with its frames found, and the gates in which they are counted."""

    run: Run
    source: PhotonSource
    gates: GatePlan
    starts: FrameStarts

    @classmethod
    def open(
        cls,
        run: Run,
        gates: GatePlan,
        *,
        tolerance_s: float | None = None,
        progress: Progress = SILENT,
    ) -> Self:
        """Find the frames of a run, whose counter must resolve the shortest gate."""
        source = run.open_photons()
        shortest = (gates.click_width_s if gates.clicks else gates.length_s).min()
        # Ticks of the counter that a gate must have at least
        if shortest < 10 * source.tick_s:
            raise InputError(
                f"{source.path} has times in steps of {time_text(source.tick_s)}, too coarse for "
                f"gates of {time_text(shortest)}: give a longer exposure"
            )
        starts = find_frames(
            source,
            run.acquisition,
            run.manifest,
            tolerance_s,
            progress=progress,
        )
        return cls(run, source, gates, starts)

    def check_gates(self) -> None:
        """Raise `InputError` if frames were so much shorter than planned that gates do not fit."""
        manifest = self.run.manifest
        gates = self.gates
        pictures = self.starts.pictures_s[manifest.shown]
        room = pictures - gates.settle_s
        over = gates.repeats * gates.length_s - room - MOST_DRIFT * pictures
        if over.max() > 0:
            exposure = float((room / manifest.shares).min()) / gates.repeats
            raise InputError(
                f"{self.source.path} has frames {-self.starts.drift:.2%} shorter than planned, and "
                f"{gates.repeats} exposures do not fit: give --exposure {exposure:.4g} or less, or "
                "fewer --repeats"
            )

    def count_in(self, *sets: Windows, progress: Progress = SILENT) -> list[WindowCounts]:
        """Photons of the passes that were recorded whole, in sets of windows."""
        inputs = self.run.acquisition.inputs
        return count_in_windows(self.source, self.starts, sets, inputs, progress=progress)

    def find_late(self, gated: WindowCounts) -> tuple[Fault, ...]:
        """Fault of markers that all come late."""
        pictures = self.starts.pictures_s[self.run.manifest.shown]
        ends = self.gates.settle_s + self.gates.repeats * self.gates.length_s
        return find_lateness(
            *gated.around_first_mask(self.run.manifest.arm), room_s=float((pictures - ends).min())
        )

    def check_lit(self, lit: np.ndarray, *, inverted: bool = False) -> None:
        """Raise `InputError` if no pass has light, saying which inputs have photons."""
        if lit.any():
            return
        if inverted:
            raise InputError(
                f"{self.source.path} has bright all-OFF frames and dark all-ON ones: the mirrors "
                "are inverted, or a marker is missing at one end and another is extra; export the "
                "patterns again with --invert, or give the inputs of the arms in the other order"
            )
        photons = sorted(summarise(self.source.path).photons.items())
        there = ", ".join(f"{number} photons on input {k + 1}" for k, number in photons)
        raise InputError(
            f"{self.source.path} has no light on input {name_inputs(self.run.acquisition.inputs)}: "
            "no all-ON frame is brighter than the all-OFF ones. The file holds "
            f"{there or 'no photons'}: give the input that the detector is wired to and the "
            "patterns that were shown, or switch on the lamp"
        )

    def find_ambient(self, gated: WindowCounts, corrections: Corrections) -> Ambient:
        """Background of passes with the scene dark."""
        manifest = self.run.manifest
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
        """Counts of all scenes, with what the run and its gates say."""
        scenes = len(self.run.acquisition.scenes)
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
            lengths_s=self.run.manifest.lengths_by_readout(self.gates.length_s),
            drift=self.starts.drift,
            inputs=self.run.acquisition.inputs,
        )


def _count_photons(
    run: Run, gates: GatePlan, settings: CountSettings, progress: Progress
) -> Counts:
    """Photons of each readout, and what arrived, corrected and less no background yet."""
    manifest = run.manifest
    acquisition = run.acquisition
    effects = settings.effects
    calibration = run.folder / "calibration"
    if effects is None and (calibration / "calibration.json").is_file():
        effects = Calibration.load(calibration).effects
    effects = effects or NO_EFFECTS
    corrections = Corrections.of(effects, manifest, settings.gains)
    names = [scene.name for scene in acquisition.scenes]
    dark = names.index(settings.background) if settings.background in names else None
    ambient = Ambient.none(manifest)
    if settings.background is not None and dark is None:
        ambient = _read_ambient(Path(settings.background), run, gates, corrections)
    recording = _Recording.open(
        run, gates, tolerance_s=settings.tolerance_s, progress=progress.between(0.0, 0.4)
    )
    recording.check_gates()
    starts = recording.starts
    source = str(recording.source.path)
    gated, parted = recording.count_in(
        Windows.of_gates(manifest, gates, starts),
        Windows.of_parts(starts, gates.settle_s, PARTS_OF_FRAME),
        progress=progress.between(0.4, 1.0),
    )
    of_dark = []
    if dark is not None:
        others = gated.scenes != dark
        ambient = recording.find_ambient(gated.select(~others), corrections)
        gated = gated.select(others)
        parted = parted.select(others)
        detail = "it was dark, and its counts are subtracted from those of the others"
        of_dark.append(Fault(kind="background", scene=dark, detail=detail))
    photons, spent = gated.per_frame()
    rates = photons / spent[..., None]
    corrections.check(rates, manifest.frames, acquisition.inputs, source)
    factors = corrections.factors(rates)
    shape = (len(parted.scenes), len(manifest.frames), PARTS_OF_FRAME)
    parts = parted.photons.reshape(*shape, -1)
    arrivals = Arrivals(
        manifest.frames,
        photons=parts * factors.arrivals[:, :, None],
        variance=parts * factors.variance[:, :, None],
        seconds=parted.open_s.reshape(shape),
    )
    light = check_light(arrivals, manifest, acquisition.inputs, scenes=gated.scenes)
    on, off = (
        (rates * factors.arrivals)[:, frames].mean(axis=1)[:, manifest.arm].sum(axis=1)
        for frames in (ALL_ON, ALL_OFF)
    )
    recording.check_lit(light.lit, inverted=off.sum() > 2 * on.sum())
    counts = gated.gates(gates.repeats)
    return recording.counts(
        gated.scenes,
        Estimate.of(counts, factors, manifest).by_readout(manifest),
        RunLight(
            on_rate=on,
            off_rate=off,
            flux=ambient.of_flux(light.flux, source),
            dark_rate=manifest.by_rail(light.dark_rate),
            faults=(*recording.find_late(gated), *light.faults, *of_dark),
        ),
        counts=manifest.by_readout(counts),
        exposure_s=settings.exposure_s or acquisition.exposure_s,
        ambient=ambient.counts,
        ambient_variance=ambient.variance,
        effects=effects,
        gains=settings.gains,
    )


def _count_clicks(run: Run, gates: GatePlan, settings: CountSettings, progress: Progress) -> Counts:
    """Clicks of each readout: of every gate of an exposure one photon at most."""
    manifest = run.manifest
    acquisition = run.acquisition
    recording = _Recording.open(
        run, gates, tolerance_s=settings.tolerance_s, progress=progress.between(0.0, 0.4)
    )
    recording.check_gates()
    gated, parted = recording.count_in(
        Windows.of_gates(manifest, gates, recording.starts),
        Windows.of_clicks(gates, len(acquisition.scenes)),
        progress=progress.between(0.4, 1.0),
    )
    recording.check_lit(gated.photons)
    fired = np.minimum(parted.photons, 1)
    opened = (parted.open_s > 0)[..., None]
    clicks = manifest.by_readout(sum_exposures(fired, gates, manifest.shown, gates.repeats))
    light = light_of_clicks(
        *(
            sum_exposures(values, gates, np.array(ENDS), 1)[:, 0]
            for values in (parted.photons, fired, opened)
        ),
        width_s=float(gates.click_width_s[0]),
        scenes=len(parted.scenes),
        manifest=manifest,
    )
    # Where clicks do not tell the flux, it is the one that was stated
    flux = np.where(np.isfinite(light.flux), light.flux, acquisition.flux or np.nan)
    faults = recording.find_late(gated)
    ambient = Ambient.none(manifest)
    return recording.counts(
        parted.scenes,
        Estimate(clicks.astype(float), variance_of_clicks(clicks, gates.clicks)),
        replace(light, flux=flux, faults=faults),
        counts=clicks,
        exposure_s=settings.exposure_s or acquisition.exposure_s,
        ambient=ambient.counts,
        ambient_variance=ambient.variance,
        gates=gates.clicks,
    )


def _read_ambient(folder: Path, run: Run, gates: GatePlan, corrections: Corrections) -> Ambient:
    """Background that a run with the scene dark has, in the gates of another."""
    if not folder.is_dir():
        raise InputError(
            f"there is no scene and no folder {folder}: give the name of a scene that was dark, "
            "or the folder of a run with the scene dark"
        )
    dark = read_run(folder).acquisition
    wired = run.acquisition
    if dark.manifest_sha256 != wired.manifest_sha256:
        raise InputError(
            f"{folder} was recorded with other patterns: record the dark scene as the others"
        )
    rewired = dark.rewired(wired.inputs, wired.marker_bit)
    recording = _Recording.open(Run(folder, rewired, run.patterns), gates)
    (counts,) = recording.count_in(Windows.of_gates(run.manifest, gates, recording.starts))
    return recording.find_ambient(counts, corrections)
