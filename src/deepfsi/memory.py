"""Memory that is planned before it is used."""

import psutil

from deepfsi.errors import InputError


def free_memory() -> float:
    """Bytes that programs may still take on this machine without swapping."""
    return float(psutil.virtual_memory().available)


def check_memory(needed: float, free: float, what: str, advice: str) -> None:
    """Raise `InputError` where something would not fit."""
    if needed > free:
        raise InputError(
            f"{what} need {needed / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB are free: "
            f"{advice}"
        )
