"""Write Indian Pines into a folder, its lost bytes restored, from the copy in the package tensorly.

    pip install tensorly
    python benchmarks/indian_pines.py $DEEPFSI_DATA/indian_pines

The copy (BSD 3-Clause) was once transferred as a text: every byte 13, a carriage return, became 10,
a line feed. None of its 8.4 million bytes is 13. A high byte that changed took 768 from a value.
"""

import argparse
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import numpy.typing as npt

CUBE, LABELS = "Indian_pines_corrected", "Indian_pines_gt"

CARRIAGE_RETURN, LINE_FEED = 13, 10
"""The byte that the cube lost, and what it became."""


def restore_high_bytes(
    cube: npt.NDArray[np.uint16], low: int = LINE_FEED
) -> npt.NDArray[np.uint16]:
    """The cube (H, W, B) with the high bytes 13 that became 10.

    Spectra of a scene are nearly combinations of a few. Each band is predicted from the components
    of all other bands, fitted to pixels whose value is sure; of the two values that a byte may
    stand for, 768 apart, the nearer one is taken. On sound bytes one value in 1300 to 22 000 is
    chosen wrongly, nearly all in the first band.
    """
    lower = cube.reshape(-1, cube.shape[2]).astype(float)
    unsure = (cube.astype(np.uint16) >> 8).reshape(lower.shape) == low
    gap = 256.0 * (CARRIAGE_RETURN - LINE_FEED)
    fitted = np.arange(len(lower)) % 4 == 0  # of four pixels one is fitted to
    values = np.where(unsure, 0.0, lower)
    values = np.where(unsure, values.sum(axis=0) / np.maximum((~unsure).sum(axis=0), 1), lower)
    for number in range(12):  # in four passes values are expected, in the others chosen
        scaled = (values - values.mean(axis=0)) / np.maximum(values.std(axis=0), 1.0)
        axes = np.linalg.eigh(scaled.T @ scaled)[1][:, -20:]  # components of spectra
        scores = scaled @ axes
        for band in np.flatnonzero(unsure.any(axis=0)):
            asked = np.flatnonzero(unsure[:, band])
            sure = np.flatnonzero(fitted & ~unsure[:, band])
            known, unknown = (
                np.c_[scores[rows] - scaled[rows, band, None] * axes[band], np.ones(len(rows))]
                for rows in (sure, asked)
            )
            weights = np.linalg.lstsq(known, lower[sure, band], rcond=None)[0]
            expected = unknown @ weights
            either = lower[asked, band]
            nearer = abs(either + gap - expected) < abs(either - expected)
            values[asked, band] = expected if number < 4 else either + gap * nearer
    return values.reshape(cube.shape).astype(np.uint16)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args(argv).folder
    [package] = find_spec("tensorly").submodule_search_locations
    copy = Path(package, "datasets", "data")
    folder.mkdir(parents=True, exist_ok=True)
    np.save(
        folder / f"{CUBE}.npy", restore_high_bytes(np.load(copy / f"{CUBE}.npy").astype(np.uint16))
    )
    np.save(folder / f"{LABELS}.npy", np.load(copy / f"{LABELS}.npy"))


if __name__ == "__main__":
    main()
