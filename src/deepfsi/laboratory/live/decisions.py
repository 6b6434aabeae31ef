"""Decisions of a live run, from counts alone: the class of each scene, and what to show next.

One code serves a run and its replay. It asks for the counts of a list of frames; devices show and
count them, or a recording is looked up. So a replay that is given the same counts comes to the same
decisions, bit by bit.

Each scene begins with an all-ON and an all-OFF frame. A scene whose all-ON frame is no brighter
than the all-OFF ones has no light, and gets no class. The budget is the flux of the all-ON frames
of all lit scenes so far, as scenes differ in brightness and a dim one is to stay dim; the dark
counts are those of the all-OFF frames so far.

Counts are corrected for dead time frame by frame, at the rate of each. An all-ON frame beyond the
rate up to which that is sure ends the run; a short gate that is, by chance, is corrected as there.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from deepfsi.errors import InputError
from deepfsi.hardware.patterns.sequence import Manifest
from deepfsi.hardware.patterns.timing import usual_tolerance
from deepfsi.hardware.recording.acquisition import Acquisition
from deepfsi.hardware.recording.live_settings import MARGIN_NS
from deepfsi.hardware.recording.readouts import by_readout
from deepfsi.hardware.recording.tails import excess_chance
from deepfsi.laboratory.live.loop import Loop, judge

ON, OFF = 0, 1
"""Places of the all-ON and the all-OFF frame among the frames of a manifest."""

NO_LIGHT = 0.01
"""Chance at most by which a scene without light is taken for one with light."""

SENTINELS = -1
"""Number of the list of frames that begins each scene."""


@dataclass(frozen=True)
class FrameList:
    """Frames that are shown one after another, and counted."""

    look: int  # from 0; `SENTINELS` for the frames that begin a scene
    frames: np.ndarray  # (F,): Places among the frames of the manifest
    gate_ns: np.ndarray  # (F,): For how long each is counted


Count = Callable[[FrameList], np.ndarray]
"""Counts (F, inputs) of a list of frames."""


@dataclass(frozen=True)
class Decision:
    """Answer after a look at a scene."""

    scene: int  # from 0
    look: int
    chances: np.ndarray  # (C,): Probabilities of the classes
    photons: float  # budget of a whole exposure, in counts
    light_s: float  # exposure so far, seconds
    final: bool  # true if no look follows


class Observer:
    """Decisions on scene after scene of a live run."""

    def __init__(self, loop: Loop, manifest: Manifest, acquisition: Acquisition) -> None:
        if acquisition.live is None or manifest.looks is None:
            raise InputError("this acquisition is no live run: make one with `deepfsi camera live`")
        self.loop, self._manifest = loop, manifest
        self._settings, self._exposure_ns = acquisition.live, round(acquisition.exposure_s * 1e9)
        self._meter = _LightMeter(manifest)
        masks = np.array([manifest.frames[at].mask for at in manifest.shown])
        rails = np.array([manifest.frames[at].rail for at in manifest.shown])
        self._places = manifest.looks.places(masks, rails == "minus")
        first = (manifest.frames[place].picture_us * 1000 for place in (ON, OFF))
        settle = acquisition.settle_s + usual_tolerance(manifest)
        gates = np.array([us - round(settle * 1e9) - MARGIN_NS for us in first])
        if gates.min() < 1:
            raise InputError(
                f"all-ON and all-OFF frames of {manifest.frames[ON].picture_us} µs are too short "
                "to be counted: export with a longer --dwell"
            )
        self._sentinels = FrameList(SENTINELS, np.array([ON, OFF]), gates)

    def observe(self, scene: int, count: Count) -> Iterator[Decision]:
        """Decisions after each look at the next scene; none if there is no light."""
        header = self.loop.header
        arrivals = self._arrivals(count, self._sentinels)
        if not self._meter.add(arrivals, self._sentinels.gate_ns):
            return
        photons = self._settings.photons or self._meter.flux * self._exposure_ns * 1e-9
        features, dwell, light_ns = np.zeros(header.features), np.zeros(header.frames), 0
        shortest = self._settings.shortest_ns / self._exposure_ns
        inputs = self.loop.inputs(features, dwell)
        for look in range(header.looks):
            shown, gates = self._frames_of(self.loop.choose(inputs, look, shortest), look)
            counts = self._by_rail(self._arrivals(count, shown), shown)
            features += self.loop.features(counts) / photons
            dwell += gates / self._exposure_ns
            light_ns += int(shown.gate_ns.sum())
            inputs = self.loop.inputs(features, dwell)
            chances, enough = judge(self.loop.classify(inputs), look, self._settings.rule)
            final = enough or look == header.looks - 1
            yield Decision(scene, look, chances, float(photons), light_ns * 1e-9, final)
            if final:
                return

    def _arrivals(self, count: Count, asked: FrameList) -> np.ndarray:
        """Photons (F, inputs) that arrived in the gates of a list, of those that were counted."""
        counts, dead = count(asked), self._settings.dead_time
        if not dead.seconds:
            return counts
        rates, most = counts / (asked.gate_ns * 1e-9)[:, None], dead.most_registered
        if asked.look == SENTINELS and rates.max() > most:
            raise InputError(
                f"an all-ON frame has {rates.max():.3g} counts/s, and a dead time of {dead}, is "
                f"corrected up to {most:.3g}: dim the light, or give the counter's own dead time"
            )
        return counts * dead.correction(np.minimum(rates, most)).arrivals

    def _frames_of(self, asked: np.ndarray, look: int) -> tuple[FrameList, np.ndarray]:
        """Frames of a look, and the gates (q,) of all, for dwells that are asked for."""
        gates = np.rint(asked * self._exposure_ns).astype(np.int64)
        own = gates[self._places]
        kept = own > 0
        return FrameList(look, self._manifest.shown[kept], own[kept]), gates

    def _by_rail(self, counts: np.ndarray, shown: FrameList) -> np.ndarray:
        """Counts (rails, m, D) of a look less their dark counts, of counts (F, inputs)."""
        manifest, header = self._manifest, self.loop.header
        every = np.zeros((len(manifest.shown), manifest.inputs))
        rows = np.searchsorted(manifest.shown, shown.frames)
        every[rows] = counts - self._meter.dark * (shown.gate_ns * 1e-9)[:, None]
        return by_readout(manifest, every).reshape(header.rails, header.masks, header.detectors)


class _LightMeter:
    """Flux and dark counts of the all-ON frames of lit scenes and the all-OFF frames so far."""

    def __init__(self, manifest: Manifest) -> None:
        self._arm, self._two = manifest.detector_count, manifest.two_arm
        self._counts = np.zeros((2, manifest.inputs))
        self._ns = np.zeros(2, np.int64)

    def add(self, counts: np.ndarray, gate_ns: np.ndarray) -> bool:
        """Count the all-ON and all-OFF frame of a scene, (2, inputs); true if it has light."""
        self._counts[OFF] += counts[OFF]
        self._ns[OFF] += gate_ns[OFF]
        on, off = (each[: self._arm].sum() for each in (counts[ON], self._counts[OFF]))
        if excess_chance(on, gate_ns[ON], off, self._ns[OFF]) > NO_LIGHT:
            return False
        self._counts[ON] += counts[ON]
        self._ns[ON] += gate_ns[ON]
        return True

    @property
    def _rates(self) -> np.ndarray:
        """Counts/s (2, inputs) of all-ON and all-OFF frames."""
        return self._counts / (self._ns * 1e-9)[:, None]

    @property
    def flux(self) -> float:
        """Counts/s of the scenes' light with all mirrors ON."""
        on, off = self._rates[:, : self._arm]
        return float((on - off).sum())

    @property
    def dark(self) -> np.ndarray:
        """Counts/s of each input where no mirror sends it light, (inputs,)."""
        on, off = self._rates
        return np.concatenate([off[: self._arm], on[self._arm :]]) if self._two else off
