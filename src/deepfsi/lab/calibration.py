"""Calibration of a camera from files alone: pictures of spots to show, and the fit to their run."""

from pathlib import Path

from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.datasets.display import read_display
from deepfsi.designfile.view_test import SceneReadouts
from deepfsi.hardware.calibration.fit import calibrate_run
from deepfsi.hardware.calibration.reconstruction import reconstruct
from deepfsi.hardware.calibration.reference import (
    ReferenceFit,
    find_reference,
    find_reference_of_masks,
)
from deepfsi.hardware.calibration.scans import find_detectors, find_gains, save_detectors
from deepfsi.hardware.counting.acquisition import Calibration, read_run
from deepfsi.hardware.counting.counts import Counts, read_counts
from deepfsi.hardware.live.replay import is_live, replay_run
from deepfsi.lab.looks import open_looks


def calibrate(folder: Path, spots: Path, out: Path) -> tuple[Calibration, Path, Path | None]:
    """Fit the camera's view to a counted run of the spots, and write it to a folder."""
    run = read_run(folder)
    display = read_display(spots)
    counts = _photons(folder)
    fitted = calibrate_run(
        dict(zip(display.names, display.x, strict=True)),
        [scene.name for scene in run.acquisition.scenes],
        pictures=reconstruct(folder),
        counts=counts,
        patterns=run.patterns,
    )
    several = run.patterns.manifest.detectors
    labels = find_detectors(counts, run.patterns) if several and several.cells is None else None
    file = fitted.save(out)
    return fitted, file, None if labels is None else save_detectors(labels, out)


def check_view(folder: Path, report: Progress = SILENT) -> ReferenceFit:
    """Place of scenes on the device, from a counted run of the reference target."""
    if not is_live(folder):
        return find_reference(_photons(folder), read_run(folder).patterns, report)
    replayed = replay_run(folder, open_looks(folder / "patterns"), report)
    lit = [scene.rows for scene in replayed.scenes if scene.rows is not None]
    if not lit:
        raise InputError(f"no scene of {folder} had light: record the reference again")
    rows = SceneReadouts.join(lit)
    variance = rows.counts.clip(min=0) + rows.noise
    manifest = read_run(folder).patterns.manifest
    return find_reference_of_masks(rows.masks, rows.counts, variance, manifest, report=report)


def gains_of(flat: Path) -> tuple[float, ...]:
    """Relative efficiency of each detector, from a counted run of a uniform white scene."""
    return find_gains(_photons(flat), read_run(flat).patterns)


def _photons(folder: Path) -> Counts:
    """Counts of a run, or `InputError` if they are clicks."""
    return read_counts(folder).check_photons(folder)
