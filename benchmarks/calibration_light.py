"""Light that a calibration needs: spots found and error of the view against photons a spot.

    python benchmarks/calibration_light.py                    # 32 x 32 cells, raster and Hadamard
    python benchmarks/calibration_light.py --cells 8 --photons 1e4 --seeds 1

The virtual laboratory's optics (tilted, blurred, darker at the edges), its photomultiplier with 100
dark counts/s, and the spots of a scan as they are. Photons are those that the light of one spot
brings to the device during one whole exposure: a raster counts one cell's at a time, Hadamard masks
half.
Errors are distances on the device from where the true view puts the display's corners, the largest
of four, root mean square over seeds, beside what the calibration says of itself.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from scipy.linalg import lstsq

from deepfsi.base.errors import InputError
from deepfsi.camera.device import Device
from deepfsi.counting.acquisition import Calibration
from deepfsi.lab.calibration import SCAN_NAMES, fit_calibration, scan_rails, spot_scenes
from deepfsi.lab.virtual_optics import arrival_rates
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.manifest import GatePlan
from deepfsi_paper.camera.gate_counts import draw_counts
from deepfsi_paper.camera.laboratory import LAB

DEVICE = Device(name="small", columns=256, rows=192)
CAMERA = LAB.model_copy(update={"blur": LAB.blur / 4, "dark": 0.0})
EXPOSURE_S = 10.0


def corner_error(found: Calibration, cells: int) -> float:
    corners = np.array([[0, 0, 1], [0, 1, 1], [1, 0, 1], [1, 1, 1]], dtype=float).T
    places = [np.asarray(view) @ corners for view in (found.homography, CAMERA.view)]
    ours, true = (place[:2] / place[2] for place in places)
    return float(cells * np.hypot(*(ours - true)).max())


def pictures(
    patterns: Patterns, rates: np.ndarray, flux: float, rng: np.random.Generator
) -> np.ndarray:
    """Least-squares pictures of one exposure of each scene, less the dark counts."""
    gates = GatePlan.of(patterns.manifest, EXPOSURE_S, repeats=1)
    arrivals = flux * rates + LAB.dark
    counts = draw_counts(arrivals, patterns.manifest, gates, CAMERA, rng)[:, 0]
    lengths = patterns.rails.max(axis=-1) * EXPOSURE_S
    read = lengths > 0
    signal = counts[:, read] - LAB.dark * lengths[read]
    found = lstsq(patterns.rails[read], signal.T)[0].T
    return found.reshape(len(rates), *patterns.manifest.image_shape)


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=32)
    parser.add_argument("--photons", type=float, nargs="+", default=[1e3, 3e3, 1e4, 1e5, 1e6])
    parser.add_argument("--seeds", type=int, default=5)
    arguments = parser.parse_args(words)

    spots, cells = spot_scenes(), (arguments.cells, arguments.cells)
    scenes = np.concatenate([spots, np.ones((1, 32, 32)), np.zeros((1, 32, 32))])
    print("| patterns | photons a spot | spots of 25, least | error (cells) | error it states |")
    print("| --- | --- | --- | --- | --- |")
    for name in SCAN_NAMES:
        scan = scan_rails(name, cells)
        with tempfile.TemporaryDirectory() as folder:
            dwell_s = 1.1 * EXPOSURE_S * float(scan.rails.max())
            patterns = Patterns.from_rails(scan, DEVICE, dwell_s).write(Path(folder) / "scan")
            rates = arrival_rates(patterns, scenes, CAMERA, 1.0)
        for photons in arguments.photons:
            flux = photons / EXPOSURE_S * 32 * 32 / spots[0].sum()
            found = []
            for seed in range(arguments.seeds):
                shot = pictures(patterns, rates, flux, np.random.default_rng(seed))
                try:
                    found.append(
                        fit_calibration(
                            spots, shot[:-2], patterns.manifest.grid, white=shot[-2], black=shot[-1]
                        )
                    )
                except InputError:
                    break
            if len(found) < arguments.seeds:
                print(f"| {name} | {photons:.0e} | too few to fit | | |")
                continue
            off = [corner_error(each, arguments.cells) for each in found]
            print(
                f"| {name} | {photons:.0e} | {min(each.spots for each in found)} | "
                f"{np.sqrt(np.mean(np.square(off))):.3f} | "
                f"{np.mean([each.error for each in found]):.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
