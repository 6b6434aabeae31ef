"""Which classes are taken for which."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

MOST_CLASSES = 20
"""Classes whose whole matrix can be read; of more, the most frequent confusions are told."""

MOST_PAIRS = 10
"""Confusions that are told of many classes."""


def shares(confusion: Sequence[Sequence[int]]) -> npt.NDArray[np.float64]:
    """Share of each answer among the scenes of each true class; 0 of a class without scenes."""
    counts = np.asarray(confusion, dtype=float)
    return counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)


def frequent(confusion: Sequence[Sequence[int]]) -> list[tuple[int, int, float]]:
    """True class, wrong answer and the answer's share, of the most frequent ones."""
    wrong = shares(confusion)
    np.fill_diagonal(wrong, 0)
    rows, columns = np.unravel_index(np.argsort(-wrong, axis=None, kind="stable"), wrong.shape)
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return [(i, j, float(wrong[i, j])) for i, j in pairs if wrong[i, j] > 0][:MOST_PAIRS]
