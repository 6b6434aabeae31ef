"""Scans: patterns that take pictures without a design, and what they tell of the detectors.

Pictures are least-squares estimates of scenes from the counts of any masks.
"""

import io
import math
import os
from pathlib import Path

import numpy as np

from deepfsi.base.errors import InputError, check_choice
from deepfsi.base.files import write_atomically
from deepfsi.camera.detectors import DetectorMap
from deepfsi.hardware.counting.acquisition import read_run
from deepfsi.hardware.counting.counts import Counts, read_counts
from deepfsi.hardware.light.checks import SPOILING
from deepfsi.hardware.patterns.folder import Patterns
from deepfsi.hardware.patterns.manifest import DesignRails

SCAN_NAMES = ("raster", "hadamard")
"""Scans by name: one cell after another, or Hadamard masks of two frames each."""

MOST_CELLS = 64 * 64
"""Cells of a scan at most: a calibration with larger cells serves masks with smaller ones."""

WORST_GAIN = 0.01
"""Standard error of a detector's efficiency at most, a share."""


def scan_rails(name: str, cells: tuple[int, int], detectors: int = 1) -> DesignRails:
    """Rails of a scan with equal dwells; its mean scene is one of uniform white.

    Hadamard masks of sides that are no power of two are those of the next larger one, cut to size.
    """
    from scipy.linalg import hadamard

    check_choice("scan", name, SCAN_NAMES)
    down, across = cells
    pixels = down * across
    if not 2 <= pixels <= MOST_CELLS:
        raise InputError(
            f"a scan of {down} x {across} cells is not allowed: give 2 to {MOST_CELLS} cells, such "
            "as 32x32; a calibration with larger cells serves masks with smaller ones"
        )
    if name == "raster":
        rails = np.eye(pixels)[None] / pixels
    else:
        axes = [hadamard(1 << (side - 1).bit_length())[:, :side] for side in cells]
        masks = np.kron(*axes)
        rails = np.stack([masks > 0, masks < 0]) / (2 * len(masks) - 1)
    several = DetectorMap(count=detectors) if detectors > 1 else None
    return DesignRails(rails, "equal-dwell", cells, float(math.prod(cells)), detectors=several)


def find_detectors(counts: Counts, patterns: Patterns) -> np.ndarray:
    """Detector of each cell: the one that counts most of its light, in all scenes together."""
    from scipy.linalg import solve

    shape = patterns.manifest.image_shape
    read = counts.lengths_s > 0
    usable = counts.by_readout(counts.valid & ~counts.spoilt[:, None])
    signal = counts.signal().sum(axis=(0, 1), where=usable)[read]
    background = (counts.background * usable.sum(axis=1)).sum(axis=0)[read]
    photons = counts.counts.sum(axis=(0, 1), where=usable)[read]
    masks = patterns.rails[read]
    inverse = solve(masks.T @ masks, masks.T, assume_a="pos")
    light = inverse @ signal
    variance = inverse**2 @ (photons + background + 1)  # that of the background is no larger
    second, best = np.argsort(light, axis=1)[:, -2:].T
    cell = np.arange(len(light))
    lead = light[cell, best] - light[cell, second]
    # Standard errors by which a detector must count more of a cell's light than any other does
    clear = lead > 5.0 * np.sqrt(variance[cell, best] + variance[cell, second])
    if not clear.all():
        place = int(np.flatnonzero(~clear)[0])
        where = " and ".join(str(axis + 1) for axis in np.unravel_index(place, shape))
        raise InputError(
            f"{np.count_nonzero(~clear)} of {len(cell)} cells are seen clearly by no detector, "
            f"first that at row and column {where}, where input "
            f"{counts.inputs[best[place]] + 1} counts {lead[place]:.3g} more than input "
            f"{counts.inputs[second[place]] + 1}: show white that fills the device, and expose "
            "longer"
        )
    idle = set(range(light.shape[1])) - set(best.tolist())
    if idle:
        raise InputError(
            f"input {counts.inputs[min(idle)] + 1} counts most in no cell: wire its detector, or "
            "export the scan for fewer `detectors`"
        )
    return best.astype(np.int64).reshape(shape)


def find_gains(counts: Counts, patterns: Patterns) -> tuple[float, ...]:
    """Efficiency of each detector over their mean, from a run of a uniform white scene.

    It is what each counts in all masks together, over what its cells of the masks send it.
    """
    manifest = patterns.manifest
    rails = patterns.rails
    several = manifest.detectors
    count = manifest.detector_count
    spoilt = [each.kind for each in counts.faults if each.kind in SPOILING and each.kind != "gain"]
    if counts.gains or spoilt:
        raise InputError(
            "the flat field's light is not what it should be, or it was corrected itself: record "
            "uniform white, and count it without a flat field"
        )
    if several is None and not manifest.two_arm:
        raise InputError("one detector has no other to be compared with: leave the flat field out")
    if several is not None and several.cells is None:
        raise InputError("nothing says which cells each detector sees: give patterns of a design")
    labels = np.zeros(rails.shape[-1], int) if several is None else np.array(several.cells)
    usable = counts.by_readout(counts.valid)

    def by_input(values: np.ndarray) -> np.ndarray:
        """Sums of readouts (rails, m, D) that each input counts, (arms, D)."""
        each = values.reshape(manifest.rails, -1, count).sum(axis=1)
        return each if manifest.two_arm else each.sum(axis=0, keepdims=True)

    found = by_input(counts.signal().sum(axis=(0, 1), where=usable))
    noise = by_input(counts.variance.sum(axis=(0, 1), where=usable))
    lit = by_input(np.stack([rails[..., labels == d].sum(axis=-1) for d in range(count)], axis=-1))
    if not (np.sqrt(noise) < WORST_GAIN * found).all():
        raise InputError(
            f"the flat field does not tell each detector's share to {WORST_GAIN:.1%}: record it "
            "longer, or with more light"
        )
    gains = (found / lit).ravel()
    return tuple((gains / gains.mean()).tolist())


def save_detectors(labels: np.ndarray, folder: Path) -> Path:
    """Write `detectors.npy` into a folder, which is made if need be."""
    file = io.BytesIO()
    np.save(file, labels)
    return write_atomically(folder / "detectors.npy", file.getvalue())


def reconstruct(folder: str | os.PathLike[str]) -> np.ndarray:
    """Least-squares picture of each scene from its counts, less background."""
    # The mean of all valid exposures, and of all pictures that explain it the one of smallest norm.
    # Directions that the masks hardly see are left out (singular values below 1e-3 of the largest)
    run = read_run(folder)
    patterns = run.patterns
    counts = read_counts(run).check_photons(folder)
    stated = run.acquisition.flux
    flux = np.nanmean(counts.flux) if stated is None else stated
    budget = float(flux * counts.exposure_s)
    if not budget > 0:
        raise InputError(f"{folder} has no light: its all-ON frames are not brighter than the dark")
    valid = np.asarray(counts.valid.any(axis=1))
    weights = counts.valid / np.maximum(counts.valid.sum(axis=1, keepdims=True), 1)
    mean = np.einsum("sr,sr...->s...", weights, counts.signal())[valid]
    read = counts.lengths_s > 0
    out = np.full((len(valid), patterns.on.shape[1]), np.nan)
    found = _solve(patterns.rails[read], mean[:, read], patterns.manifest.detectors)
    out[valid] = found * (patterns.manifest.summed_reflectance / budget)
    return out.reshape(len(valid), *patterns.manifest.image_shape)


def _solve(masks: np.ndarray, counts: np.ndarray, detectors: DetectorMap | None) -> np.ndarray:
    """Pictures (S, N) of counts (S, k[, D]) behind masks (k, N): each detector's of its cells."""
    from scipy.linalg import lstsq

    if detectors is not None and detectors.cells is not None:
        out = np.empty((len(counts), masks.shape[1]))
        labels = np.array(detectors.cells)
        for place in range(detectors.count):
            own = labels == place
            out[:, own] = _solve(masks[:, own], counts[..., place], None)
        return out
    every = counts if detectors is None else counts.sum(axis=-1)
    # Least singular value that a picture is made from, of the sensing matrix's largest
    return np.asarray(lstsq(masks, every.T, cond=1e-3)[0].T)
