"""Recordings of made-up scenes whose readouts drift, class after class or in turn."""

import numpy as np

from deepfsi.datasets import MeasuredReadouts

CLASSES, EACH, MODES = 3, 400, 5


def drifting(
    order: str, drift: float = 3.0, seed: int = 0, ordered: bool = False
) -> MeasuredReadouts:
    """Readouts (n, k) of three classes under a random walk of the set-up, which a monitor reads."""
    # order "blocks": each file one after another; "turns": file after file at each place
    rng = np.random.default_rng(seed)
    count = CLASSES * EACH
    file, place = np.repeat(np.arange(CLASSES), EACH), np.tile(np.arange(float(EACH)), CLASSES)
    time = np.arange(count) if order == "blocks" else place.astype(int) * CLASSES + file
    walk = np.cumsum(rng.normal(size=count))
    walk = drift * (walk - walk.mean()) / walk.std()
    state = walk[time]
    centres = rng.normal(scale=2.0, size=(CLASSES, MODES))
    values = (
        centres[file] + rng.normal(size=(count, MODES)) + np.outer(state, rng.normal(size=MODES))
    )
    monitor = state[:, None] + rng.normal(scale=0.05, size=(count, 2))
    return MeasuredReadouts(
        name="made up",
        values=values,
        y=file,
        classes=("a", "b", "c"),
        file=file,
        position=time.astype(float) if ordered else place,
        ordered=ordered,
        picture=None,
        monitors={"laser": monitor},
    )
