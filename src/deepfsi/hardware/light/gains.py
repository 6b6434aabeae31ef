"""Efficiencies of several detectors, held against how scenes of the training share their light.

In the mean over scenes each detector's share of the light lies among those of the classes, whatever
classes are shown. Where no mixture of classes explains the shares, detectors differ in efficiency.
"""

import numpy as np
from scipy.optimize import linprog

from deepfsi.hardware.counting.alignment import CERTAIN_SIGMAS
from deepfsi.hardware.light.faults import Fault
from deepfsi.hardware.light.sentinels import HARMLESS, Background, LightCurve
from deepfsi.hardware.patterns.detectors import Detectors


def find_gains(
    curves: list[LightCurve], backgrounds: list[Background], known: Detectors | None
) -> list[Fault]:
    """Fault of an arm's detectors that share the light of all scenes as no classes do, if any."""
    if known is None or known.shares is None or not curves:
        return []
    bright = [curve.together(curve.bright) for curve in curves]
    photons, seconds = np.array(bright).swapaxes(0, 1)  # (D, P): those of equal relative noise
    seconds = np.where(seconds > 0, seconds, np.inf)
    light = photons / seconds - np.array([each.rate for each in backgrounds])  # counts/s
    every = light.sum()
    if not every > 0:
        return []
    share, classes = light.sum(axis=1) / every, np.array(known.shares).T
    spread = np.array(known.spread) / np.sqrt(light.shape[1])
    noise = np.sqrt(((photons + 1) / seconds**2).sum(axis=1)) / every
    allowed = HARMLESS * classes.max(axis=1) + CERTAIN_SIGMAS * np.hypot(spread, noise)
    off, nearest = _nearest_mixture(share, classes, allowed)
    if off <= 1:
        return []
    ratio = share / np.maximum(nearest, 1e-300)
    worst = int(np.abs(np.log(np.maximum(ratio, 1e-300))).argmax())
    detail = (
        f"{ratio[worst]:.2g} times the light{curves[worst].name} that scenes of the training give "
        "it: record uniform white with these patterns, and count with --flat"
    )
    return [Fault(kind="gain", detail=detail)]


def _nearest_mixture(
    share: np.ndarray, classes: np.ndarray, allowed: np.ndarray
) -> tuple[float, np.ndarray]:
    """Largest departure from the nearest mixture of classes (D, C), over the allowed (D,)."""
    count = classes.shape[1]
    sides = np.vstack([classes, -classes])
    bounds = np.concatenate([share, -share])
    slack = -np.concatenate([allowed, allowed])[:, None]
    found = linprog(
        np.append(np.zeros(count), 1.0),
        A_ub=np.hstack([sides, slack]),
        b_ub=bounds,
        A_eq=np.append(np.ones(count), 0.0)[None],
        b_eq=[1.0],
    )
    return float(found.x[-1]), classes @ found.x[:-1]
