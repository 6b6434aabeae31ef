"""Photons counted in gates while records are read; gates may be told as late as they begin."""

from collections.abc import Sequence

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.hardware.photons.header import Header, Kind
from deepfsi.hardware.photons.records import EARLIEST_TICK, Part


def check_input(number: int, kind: Kind) -> None:
    """Raise `InputError` unless a kind of counter has an input of that number, from 0."""
    if not 0 <= number < kind.inputs:
        raise InputError(
            f"input {number}, counted from 0, is not one of {kind.name}: give 0 to "
            f"{kind.inputs - 1} (--input 1 to {kind.inputs})"
        )


class GateCounter:
    """Counter of the photons in gates."""

    def __init__(self, kind: Kind, inputs: Sequence[int], name: object) -> None:
        for each in inputs:
            check_input(each, kind)
        self._inputs, self._name = tuple(inputs), name
        self._edges = np.zeros(0, np.int64)  # starts and stops in turn, of gates not yet taken
        self._before = np.zeros((0, len(inputs)), np.int64)  # photons before each, in those done
        self._done = 0
        self._so_far = np.zeros(len(inputs), np.int64)
        self._latest = EARLIEST_TICK
        self.reached = -1  # no photon of parts to come is earlier

    def expect(self, starts: np.ndarray, stops: np.ndarray) -> None:
        """Count gates that follow those before."""
        # starts, stops (gates,)
        edges = _join_edges(starts, stops)
        if not len(edges):
            return
        every = np.concatenate([self._edges, edges])
        if (every[1:] < every[:-1]).any():
            raise InputError(
                "gates overlap or run back: give them in order, each start <= its stop"
            )
        if edges[0] <= self._latest:
            raise InputError(
                f"{self._name} holds photons up to {self._latest}, and a gate begins at "
                f"{edges[0]}: tell gates before they begin"
            )
        self._edges = every
        unknown = np.zeros((len(edges), len(self._inputs)), np.int64)
        self._before = np.concatenate([self._before, unknown])

    def add(self, part: Part) -> None:
        """Count the photons of the next part."""
        edges, until = self._edges[self._done :], 0
        if len(part.runs.high):
            self._latest = int(part.runs.high[-1])
            until = int(np.searchsorted(edges, self._latest, side="right"))
        places = part.find(edges[:until])
        before = self._before[self._done :]
        for column, each in enumerate(self._inputs):
            here, total = part.count(each, places)
            before[:until, column] = self._so_far[column] + here
            self._so_far[column] += total
        self.reached = part.reached
        ended = max(until, int(np.searchsorted(edges, self.reached, side="right")))
        before[until:ended] = self._so_far
        self._done += ended

    def take(self) -> np.ndarray:
        """Counts of the gates that have ended since the last call, int64 (gates, inputs)."""
        gates = self._done // 2
        before = self._before[: 2 * gates]
        self._edges, self._before = self._edges[2 * gates :], self._before[2 * gates :]
        self._done -= 2 * gates
        return np.asarray(before[1::2] - before[::2])

    def finish(self, header: Header) -> np.ndarray:
        """Counts of all gates since the last call, at the end of a file with this header."""
        if header.problems and len(self._edges) and self._edges[-1] > self.reached:
            raise InputError(
                f"{self._name} may lack records ({header.problems[0]}) and holds times up to "
                f"{self.reached}, but gates end at {self._edges[-1]}: count only gates that end "
                "before"
            )
        self._before[self._done :] = self._so_far
        self._done = len(self._edges)
        return self.take()


def cut_gates(starts: np.ndarray, stops: np.ndarray, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts and stops (gates · parts,) of the equal parts of gates, whole ticks."""
    # starts, stops (gates,)
    edges = starts[:, None] + (stops - starts)[:, None] * np.arange(parts + 1) // parts
    return edges[:, :-1].ravel(), edges[:, 1:].ravel()


def _join_edges(starts: np.ndarray, stops: np.ndarray) -> np.ndarray:
    """Starts and stops in turn, int64, shape (2 gates,)."""
    starts, stops = np.asarray(starts), np.asarray(stops)
    if starts.ndim != 1 or starts.shape != stops.shape:
        raise InputError(f"{starts.shape} starts and {stops.shape} stops: give one for each gate")
    for given in (starts, stops):
        if len(given) and given.dtype.kind not in "iu":
            raise InputError(f"gates in {given.dtype} are not allowed: give integer ticks")
    return np.stack([starts, stops], axis=1).astype(np.int64).ravel()
