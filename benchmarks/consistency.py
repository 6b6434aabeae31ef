"""Power of the test of counts for what a design was trained for, by fault and budget.

    python benchmarks/consistency.py                # the table of docs/notebook/run-checks.md
    python benchmarks/consistency.py --masks 32 --epochs 5

A design and one of another seed are trained on MNIST. Its test scenes, drawn in acquisitions of
40, are counted with a fault; a table says which share of acquisitions is refused or said to be
alike, and which share of scenes is unsure. Another gives the false alarms of sound ones.
"""

import argparse
from collections.abc import Callable

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from deepfsi.datasets.dataset import Dataset
from deepfsi.datasets.load import load_dataset
from deepfsi.design.design import Design
from deepfsi.designfile.distribution import REFUSED
from deepfsi.training.learning import learn

BUDGETS = (1e3, 1e4, 1e5, 1e6)
SOUND = "nothing"

SCENES = 40
"""Of an acquisition."""

ACQUISITIONS = {"faulty": 100, "sound": 2000}
"""Acquisitions of each row."""

BLUR = 2.0
"""Standard deviation of the blur, pixels."""

BURST = 0.25
"""Frames of a pass with stray light, as a share; in each, as much light as the mean readout."""


def rates_of(design: Design, x: np.ndarray) -> np.ndarray:
    """Expected counts (n, rails, m) of scenes (n, N) for a budget of one photon."""
    with torch.no_grad():
        return design.exposure.rates(design.scanner(), torch.from_numpy(x).float()).double().numpy()


def pictures(change: Callable[[np.ndarray], np.ndarray], data: Dataset) -> np.ndarray:
    """Scenes (n, N) to test with, changed as pictures (n, height, width)."""
    shown = change(data.x_test.reshape(-1, *data.image_shape).astype(float))
    return shown.reshape(len(shown), -1)


def shifted(x: np.ndarray) -> np.ndarray:
    """Pictures 4 pixels further right; what leaves on one side is lost."""
    out = np.zeros_like(x)
    out[:, :, 4:] = x[:, :, :-4]
    return out


def halved(x: np.ndarray) -> np.ndarray:
    """Pictures (n, height, width), even, at half the size in the middle, on black."""
    n, height, width = x.shape
    small = x.reshape(n, height // 2, 2, width // 2, 2).mean(axis=(2, 4))
    rows, columns = (height - height // 2) // 2, (width - width // 2) // 2
    out = np.zeros_like(x)
    out[:, rows : rows + height // 2, columns : columns + width // 2] = small
    return out


def faults(data: Dataset, design: Design, other: Design) -> dict[str, np.ndarray]:
    """Expected counts (n, rails, m) for a budget of one photon, by what is wrong."""
    sound = rates_of(design, data.x_test)
    n, rails, masks = sound.shape
    frames = sound.reshape(n, -1)
    order = np.arange(rails * masks)
    far = np.argsort(frames.mean(axis=0))[[len(order) // 4, 3 * len(order) // 4]]
    order[far] = order[far[::-1]]
    stray = np.zeros(rails * masks)
    stray[: int(BURST * len(stray))] = frames.mean()
    brightness = data.x_train.mean()
    shown = {
        "blurred": pictures(lambda x: gaussian_filter(x, (0, BLUR, BLUR)), data),
        "at half their size": pictures(halved, data),
        "shifted by 4 pixels": pictures(shifted, data),
        "inverted": 1 - data.x_test,
        "uniform": np.full_like(data.x_test, brightness),
    }
    return {
        SOUND: sound,
        "another design's photons": rates_of(other, data.x_test),
        "half the light": 0.5 * sound,
        "twice the light": 2 * sound,
        "two frames swapped": frames[:, order].reshape(sound.shape),
        "all frames one late": np.roll(frames, 1, axis=1).reshape(sound.shape),
        "stray light in a quarter of the frames": sound + stray.reshape(rails, masks),
        **{f"scenes {name}": rates_of(design, x) for name, x in shown.items()},
    }


def drawn(n: int, size: int, times: int) -> list[np.ndarray]:
    """Places of the scenes of acquisitions, drawn among n."""
    rng = np.random.default_rng(2)
    return [rng.choice(n, size, replace=False) for _ in range(times)]


def verdicts(design: Design, parts: list[np.ndarray], photons: float) -> tuple[float, float, float]:
    """Shares of acquisitions refused, of those said to be alike, and of scenes unsure."""
    rng = np.random.default_rng(1)
    found = [design.consistency(rng.poisson(part * photons), photons) for part in parts]
    return (
        float(np.mean([each.refused for each in found])),
        float(np.mean([each.alike < REFUSED for each in found])),
        float(np.mean(np.concatenate([each.unsure for each in found]))),
    )


def print_row(design: Design, name: str, parts: list[np.ndarray], digits: int) -> None:
    """Row of a table: verdicts on acquisitions at each of `BUDGETS`."""
    cells = []
    for photons in BUDGETS:
        refused, alike, unsure = verdicts(design, parts, photons)
        said = [f"{refused:.{digits}f}", f"{unsure:.{digits}f}"]
        cells.append("; ".join(said) + (f"; alike {alike:.2f}" if alike > REFUSED else ""))
    print(f"| {name} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Train, count and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--masks", type=int, default=16)
    parser.add_argument("--epochs", type=int, default=2)
    given = parser.parse_args()
    data = load_dataset(given.data)
    settings = {"masks": given.masks, "training": {"epochs": given.epochs}}
    settings["camera"] = {"light": "equal-dwell", "rails": "dual"}
    design, other = (learn(data, photons=1e4, seed=k, **settings) for k in (0, 1))
    known, n = faults(data, design, other), len(data.x_test)
    print("| what is wrong | " + " | ".join(f"{photons:.0e}" for photons in BUDGETS) + " |")
    places = drawn(n, SCENES, ACQUISITIONS["faulty"])
    for name, rates in known.items():
        if name != SOUND:
            print_row(design, name, [rates[each] for each in places], 2)
    lit = data.x_test.sum(axis=1) / data.x_train.sum(axis=1).mean()
    for size in (1, 3, SCENES):
        places = drawn(n, size, ACQUISITIONS["sound"])
        parts = [known[SOUND][each] for each in places]
        print_row(design, f"{SOUND}, {size} scenes", parts, 4)
        owned = [part / lit[each].mean() for part, each in zip(parts, places, strict=True)]
        print_row(design, f"{SOUND}, {size} scenes, budget of their ON frames", owned, 4)
    in_order = np.split(known[SOUND][: n // SCENES * SCENES], n // SCENES)
    print_row(design, f"{SOUND}, {SCENES} scenes as they follow each other", in_order, 4)


if __name__ == "__main__":
    main()
