"""Photons of a recording counted frame by frame, for the exposure it was made for or another."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from deepfsi.base import SILENT, InputError, Progress, time_text
from deepfsi.camera import NO_DEAD_TIME, DeadTime, DeadTimeFactors
from deepfsi.hardware.counting.acquisition import (
    Acquisition,
    check_fixed,
    check_inputs,
    gates_of,
    read_acquisition,
)
from deepfsi.hardware.counting.alignment import find_steps
from deepfsi.hardware.counting.ambient import Ambient
from deepfsi.hardware.counting.calibration_file import load_calibration
from deepfsi.hardware.counting.clicks import (
    ClickWindows,
    check_clicks,
    check_gated,
    light_of_clicks,
    variance_of,
)
from deepfsi.hardware.counting.counts import Counts
from deepfsi.hardware.counting.gates import (
    FrameParts,
    Windows,
    check_gates,
    count_overlapping,
    find_frame_parts,
    find_frames,
    find_lateness,
    in_ticks,
)
from deepfsi.hardware.counting.rates import check_rates
from deepfsi.hardware.light import PARTS, Arrivals, Fault, Light, check_light, name_inputs
from deepfsi.hardware.patterns.sequence import Manifest
from deepfsi.hardware.patterns.timing import ClickGates, Gates
from deepfsi.hardware.photons import PhotonSource, PtuFile, summarise

LEAST_GATE_TICKS = 10
"""Ticks of the counter that a gate must have at least."""

Correct = Callable[[np.ndarray], DeadTimeFactors]
"""Corrections of counts, at their rates."""

SHIFTED = (
    "its first and last frames are not the brightest and darkest: stray light in others, or the "
    "pass is shifted"
)
"""Why a scene is given up whose sentinels are not where they should be."""


def count(
    folder: str | os.PathLike[str],
    *,
    exposure_s: float | None = None,
    settle_s: float | None = None,
    repeats: int | None = None,
    tolerance_s: float | None = None,
    inputs: tuple[int, ...] | None = None,
    marker_bit: int | None = None,
    dead_time: DeadTime | None = None,
    background: str | None = None,
    gains: tuple[float, ...] = (),
    clicks: int | None = None,
    report: Progress = SILENT,
) -> Counts:
    """Count the photons of each readout and write counts.npz."""
    # background: the scene that was dark, or the folder of a recording with the scene dark, of the
    # same patterns and wiring. gains: relative efficiency of each detector, as `find_gains` gives
    # them. clicks: gates of a frame's exposure, of each of which the first photon alone counts
    recorded, patterns = read_acquisition(folder)
    check_fixed(recorded, folder)
    acquisition, manifest = recorded.rewired(inputs, marker_bit), patterns.manifest
    gates = gates_of(acquisition, manifest, exposure_s, settle_s, repeats)
    check_gated(acquisition, manifest, gates, clicks, folder)
    if clicks is not None:
        of_photons = {
            "dead time": dead_time is not None,
            "a background": background is not None,
            "a flat field": bool(gains),
        }
        check_clicks(clicks, of_photons)
        exposure = acquisition.exposure_s if exposure_s is None else exposure_s
        of_gates = ClickGates.of(manifest, gates, clicks)
        counts = _count_clicks(
            Path(folder), acquisition, manifest, (exposure, gates, of_gates), tolerance_s, report
        )
        counts.save(Path(folder), recorded)
        return counts
    dead, shares = _find_dead_time(Path(folder), dead_time), _check_gains(gains, manifest)

    def correct(rates: np.ndarray) -> DeadTimeFactors:
        return dead.correction(rates).divided(shares)

    names = [scene.name for scene in acquisition.scenes]
    own = names.index(background) if background in names else None
    ambient = Ambient.none(manifest)
    if background is not None and own is None:
        ambient = _read_dark(Path(background), acquisition, manifest, gates, correct)
    header = _read_counter(Path(folder) / "photons.ptu", gates.length_s, manifest)
    frames = find_frames(header, acquisition, manifest, tolerance_s, report.between(0.0, 0.4))
    check_gates(header, gates, manifest, frames)
    windows = Windows.of(manifest, gates, frames)
    whole = frames.whole
    starts, parts = frames.starts_s[whole], find_frame_parts(frames, gates.settle_s, PARTS)
    (found, seconds), (parted, parted_s) = _count_windows(
        header,
        starts,
        frames.until_s,
        (windows, parts),
        acquisition.inputs,
        report.between(0.4, 1.0),
    )
    if own is not None:
        dark, kept = (np.flatnonzero(whole) == own, np.flatnonzero(whole) != own)
        if not dark.any():
            raise InputError(f"scene {background} was not recorded whole: give another background")
        ambient = _find_ambient(windows, found[dark], seconds[dark], correct, manifest, gates)
        found, seconds, parted, parted_s = (
            each[kept] for each in (found, seconds, parted, parted_s)
        )
        whole[own] = False
    photons, spent = windows.sum_frames(found), windows.sum_frames(seconds)
    arm = slice(0, manifest.detector_count)
    fits = _show_ends(header, photons[..., arm].sum(axis=-1), spent)
    lost = np.flatnonzero(whole)[~fits]
    late = find_lateness(windows, found[fits][..., arm].sum(axis=-1), seconds[fits])
    shifted = (Fault(kind="lost", scene=scene, detail=SHIFTED) for scene in lost.tolist())
    whole[whole] = fits
    rates = photons[fits] / np.where(spent > 0, spent, np.nan)[fits, :, None]
    check_rates(dead, rates, manifest.frames, acquisition.inputs, str(header.path))
    factors = correct(rates)
    shape = len(rates), *parts.middles.shape
    parted = parted[fits].reshape(*shape, -1)
    arrivals = parted * factors.arrivals[:, :, None]
    variance = parted * factors.variance[:, :, None]
    open_s, scenes = parted_s[fits].reshape(shape), np.flatnonzero(whole)
    light = check_light(
        Arrivals(manifest.frames, arrivals, variance, open_s, parts.middles),
        manifest,
        acquisition.inputs,
        scenes=scenes,
        lost=lost,
    )
    _check_lit(header, acquisition, bool(light.lit.any()))
    flux = ambient.of_flux(light.flux, str(header.path))
    light = replace(light, flux=flux)
    gated = found[fits][:, windows.gates].swapaxes(1, 2)
    counts = Counts(
        **_by_scene(manifest, whole, gated, rates, light, factors),
        valid=np.repeat(whole[:, None], gates.repeats, axis=1),
        gate_s=gates.length_s,
        exposure_s=acquisition.exposure_s if exposure_s is None else exposure_s,
        settle_s=gates.settle_s,
        lengths_s=manifest.lengths_by_readout(gates.length_s),
        drift=frames.drift,
        inputs=acquisition.inputs,
        faults=(*frames.faults, *shifted, *late, *light.faults, *_name_dark(own)),
        ambient=ambient.counts,
        ambient_variance=ambient.variance,
        dead_time=dead,
        gains=gains,
        gates=None,
    )
    counts.save(Path(folder), recorded)
    return counts


def _count_clicks(
    folder: Path,
    acquisition: Acquisition,
    manifest: Manifest,
    asked: tuple[float, Gates, ClickGates],
    tolerance_s: float | None,
    report: Progress,
) -> Counts:
    """Clicks of each readout in exposures of so many seconds."""
    exposure, gates, of_gates = asked
    header = _read_counter(folder / "photons.ptu", of_gates.width_s, manifest)
    # Clicks saturate, so that they do not tell which frames are the brightest
    frames = find_frames(
        header, acquisition, manifest, tolerance_s, report.between(0.0, 0.4), by_light=False
    )
    check_gates(header, gates, manifest, frames)
    whole, windows = frames.whole, Windows.of(manifest, gates, frames)
    parts = ClickWindows.of(of_gates, len(acquisition.scenes))
    (found, seconds), (parted, open_s) = _count_windows(
        header, frames.starts_s[whole], frames.until_s, (windows, parts), acquisition.inputs,
        report.between(0.4, 1.0),
    )  # fmt: skip
    _check_lit(header, acquisition, bool(found.any()))
    arm = slice(0, manifest.detector_count)
    late = find_lateness(windows, found[..., arm].sum(axis=-1), seconds)
    clicks, fired = parts.sums(np.minimum(parted, 1), manifest.shown)
    photons, gates_open = (
        parts.sums(each, manifest.shown)[1] for each in (parted, (open_s > 0)[..., None])
    )
    ends = photons, fired, gates_open
    light = light_of_clicks(ends, float(of_gates.width_s[0]), len(found), manifest)
    # Where clicks do not tell the flux, it is the one that was stated
    flux = np.where(np.isfinite(light["flux"]), light["flux"], acquisition.flux or np.nan)
    counts = manifest.by_readout(_spread(whole, clicks, 0))
    ambient = Ambient.none(manifest)
    return Counts(
        on_rate=_spread(whole, light["on_rate"], np.nan),
        off_rate=_spread(whole, light["off_rate"], np.nan),
        flux=_spread(whole, flux, np.nan),
        dark_rate=_spread(whole, light["dark_rate"], 0),
        counts=counts,
        arrivals=counts.astype(float),
        variance=variance_of(counts, of_gates.number),
        valid=np.repeat(whole[:, None], gates.repeats, axis=1),
        gate_s=gates.length_s,
        exposure_s=exposure,
        settle_s=gates.settle_s,
        lengths_s=manifest.lengths_by_readout(gates.length_s),
        drift=frames.drift,
        inputs=acquisition.inputs,
        faults=(*frames.faults, *late),
        ambient=ambient.counts,
        ambient_variance=ambient.variance,
        gates=of_gates.number,
    )


def _read_dark(
    folder: Path, run: Acquisition, manifest: Manifest, gates: Gates, correct: Correct
) -> Ambient:
    """Background that a recording with the scene dark has, in the gates of another."""
    if not folder.is_dir():
        raise InputError(
            f"there is no scene and no folder {folder}: give the name of a scene that was dark, "
            "or the folder of a run with the scene dark"
        )
    recorded = read_acquisition(folder)[0]
    if recorded.manifest_sha256 != run.manifest_sha256:
        raise InputError(
            f"{folder} was recorded with other patterns: record the dark scene as the others"
        )
    acquisition = recorded.rewired(run.inputs, run.marker_bit)
    header = _read_counter(folder / "photons.ptu", gates.length_s, manifest)
    frames = find_frames(header, acquisition, manifest, None, SILENT)
    windows = Windows.of(manifest, gates, frames)
    starts = frames.starts_s[frames.whole]
    ((found, seconds),) = _count_windows(
        header, starts, frames.until_s, (windows,), acquisition.inputs, SILENT
    )
    return _find_ambient(windows, found, seconds, correct, manifest, gates)


def _find_ambient(
    windows: Windows,
    found: np.ndarray,
    seconds: np.ndarray,
    correct: Correct,
    manifest: Manifest,
    gates: Gates,
) -> Ambient:
    """Background of passes with the scene dark: photons and times in their windows."""
    photons, spent = windows.sum_frames(found), windows.sum_frames(seconds)
    factors = correct(photons / np.where(spent > 0, spent, np.inf)[..., None])
    gated = found[:, windows.gates].swapaxes(1, 2)  # (P, R, f, inputs)
    both = (
        (gated * factor[:, None, manifest.shown]).reshape(-1, *gated.shape[2:])
        for factor in (factors.arrivals, factors.variance)
    )
    whole = (photons * factors.arrivals).sum(axis=0), spent.sum(axis=0)
    arrivals, variance = both
    return Ambient.of(manifest, (arrivals, variance), whole, gates.length_s)


def _name_dark(scene: int | None) -> tuple[Fault, ...]:
    """Word on the scene whose pass measured the background."""
    if scene is None:
        return ()
    detail = "it was dark, and its counts are subtracted from those of the others"
    return (Fault(kind="background", scene=scene, detail=detail),)


def _read_counter(path: Path, lengths_s: np.ndarray, manifest: Manifest) -> PhotonSource:
    """Header of a counter's file with enough inputs, and times fine enough for gates (n,)."""
    header = PtuFile(path)
    check_inputs(manifest, header.inputs, f"{header.path} ({header.record_type})")
    if lengths_s.min() < LEAST_GATE_TICKS * header.tick_s:
        raise InputError(
            f"{header.path} has times in steps of {time_text(header.tick_s)}, too coarse for gates "
            "of "
            f"{time_text(lengths_s.min())}: give a longer exposure"
        )
    return header


def _count_windows(
    header: PhotonSource,
    frames_s: np.ndarray,
    until_s: float,
    sets: tuple[Windows | FrameParts | ClickWindows, ...],
    inputs: tuple[int, ...],
    report: Progress,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Photons (S, g, inputs) in windows (S, g), and how long each was open, seconds (S, g)."""
    # For each set of windows, of passes whose frames start at `frames_s` (S, F), and none later
    # than `until_s`. Where two clocks and a marker's jitter make a window reach into the next of
    # its set it ends there. One whose frame's start is not known is not open
    tick_s, edges, places, shapes = header.tick_s, [], [], []
    for each in sets:
        opens = frames_s[:, each.frame] + each.offset
        closes = np.minimum(opens + each.length, until_s)
        known = np.isfinite(opens).ravel()
        starts = in_ticks(opens.ravel()[known], tick_s)
        stops = in_ticks(closes.ravel()[known], tick_s)
        starts = np.minimum(np.minimum.accumulate(starts[::-1])[::-1], stops.max(initial=0))
        stops[:-1] = np.minimum(stops[:-1], starts[1:])
        edges.append(np.stack([starts, stops]))
        places.append(known)
        shapes.append(opens.shape)
    every = np.concatenate(edges, axis=1)
    photons = np.split(
        count_overlapping(header.path, every[0], every[1], inputs, report),
        np.cumsum([each.shape[1] for each in edges])[:-1],
    )
    out = []
    for shape, known, (starts, stops), counted in zip(shapes, places, edges, photons, strict=True):
        found = np.zeros((known.size, len(inputs)), np.int64)
        seconds = np.zeros(known.size)
        found[known] = counted
        seconds[known] = (stops - starts) * tick_s
        out.append((found.reshape(*shape, len(inputs)), seconds.reshape(shape)))
    return out


def _find_dead_time(folder: Path, given: DeadTime | None) -> DeadTime:
    """Dead time that is given, or that the calibration in a folder knows."""
    if given is None and (folder / "calibration" / "calibration.json").is_file():
        given = load_calibration(folder / "calibration").dead_time
    return given or NO_DEAD_TIME


def _check_gains(gains: tuple[float, ...], manifest: Manifest) -> np.ndarray:
    """Gains (inputs,) of all detectors, 1 where none are given."""
    if gains and len(gains) != manifest.inputs:
        raise InputError(
            f"the flat field is of {len(gains)} detectors, and these patterns are for "
            f"{manifest.inputs}: record it with the same detectors"
        )
    return np.array(gains or (1.0,) * manifest.inputs)


def _check_lit(header: PhotonSource, acquisition: Acquisition, lit: bool) -> None:
    """Raise `InputError` if no pass has light, saying which inputs have photons."""
    if lit:
        return
    contents = summarise(header.path)
    there = ", ".join(f"{n} photons on input {k + 1}" for k, n in sorted(contents.photons.items()))
    asked = name_inputs(acquisition.inputs)
    raise InputError(
        f"{header.path} has no light on input {asked}: no all-ON frame is brighter than the "
        f"all-OFF ones. The file holds {there or 'no photons'}: give the input that the detector "
        "is wired to, or switch on the lamp"
    )


def _show_ends(header: PhotonSource, photons: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """Passes whose first and last two frames are all ON and all OFF, as far as photons tell."""
    # From photons and seconds (S, F). At least one of each must have been recorded
    fits = np.array(
        [
            spent[[0, -2]].any()
            and spent[[1, -1]].any()
            and find_steps(found, spent)[0][[0, -1]].all()
            for found, spent in zip(photons, seconds, strict=True)
        ]
    )
    if not fits.any():
        with np.errstate(invalid="ignore"):
            rates = np.nanmean(np.where(seconds > 0, photons / seconds, np.nan), axis=0)
        if min(rates[[1, -1]]) > 2 * max(rates[[0, -2]]):
            raise InputError(
                f"{header.path} has bright all-OFF frames and dark all-ON ones: the mirrors are "
                "inverted; export the patterns again with --invert, or give the inputs of the arms "
                "in the other order"
            )
        raise InputError(
            f"{header.path} has no pass that begins and ends with a bright and a dark frame: give "
            "the patterns that were shown, and the input that the detector is wired to"
        )
    return fits


def _spread(whole: np.ndarray, values: np.ndarray, lost: float) -> np.ndarray:
    """Values (S, ...) of all scenes, from those (P, ...) of scenes that were recorded whole."""
    out = np.full((len(whole), *values.shape[1:]), lost, values.dtype)
    out[whole] = values
    return out


def _by_scene(
    manifest: Manifest,
    whole: np.ndarray,
    gated: np.ndarray,
    rates: np.ndarray,
    light: Light,
    factors: DeadTimeFactors,
) -> dict[str, np.ndarray]:
    """Readouts of gates (P, R, f, inputs) and rates of frames (P, F, inputs), of all scenes."""

    def readouts(factor: np.ndarray | int) -> np.ndarray:
        return _spread(whole, manifest.by_readout(gated * factor), 0)

    rates, arm = rates * factors.arrivals, slice(0, manifest.detector_count)
    on, off = (np.nanmean(rates[:, frames], axis=1) for frames in ([0, -2], [1, -1]))
    return {
        "counts": readouts(1),
        "arrivals": readouts(factors.arrivals[:, None, manifest.shown]),
        "variance": readouts(factors.variance[:, None, manifest.shown]),
        "on_rate": _spread(whole, on[:, arm].sum(axis=1), np.nan),
        "off_rate": _spread(whole, off[:, arm].sum(axis=1), np.nan),
        "flux": _spread(whole, light.flux, np.nan),
        "dark_rate": _spread(whole, manifest.by_rail(light.dark_rate), 0),
    }
