"""Check of rates: a counter too near its saturation cannot be corrected for its dead time."""

from collections.abc import Sequence

import numpy as np

from deepfsi.base import InputError
from deepfsi.camera import DeadTime
from deepfsi.hardware.patterns.sequence import Frame


def check_rates(
    dead: DeadTime,
    registered: np.ndarray,
    frames: Sequence[Frame],
    inputs: Sequence[int],
    name: str,
) -> None:
    """Raise `InputError` where a counter is too near its saturation to be corrected."""
    # registered (S, F, inputs)
    most = dead.most_registered
    if not (registered > most).any():
        return
    worst = _, frame, column = np.unravel_index(np.nanargmax(registered), registered.shape)
    raise InputError(
        f"{name} has {registered[worst]:.3g} counts/s on input {inputs[int(column)] + 1} in "
        f"{frames[int(frame)]}, and a dead time of {dead}, is corrected up to {most:.3g}: dim the "
        "light, or give the counter's own dead time"
    )
