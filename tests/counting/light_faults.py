"""Acquisitions whose light has a course in time: sound ones, and with faults."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from counting.recording_samples import DEVICE, DWELL, SHAPE, named, split, write_photons
from deepfsi.counting.counts import Counts
from deepfsi.counting.recording import Recording
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.manifest import Brightness
from deepfsi.patterns.rails import DesignRails

SETTLE = 2e-5
WITHIN = 0.04
BRIGHTNESS = Brightness(low=0.87, high=1.14, between=1.03, within=0.05)
ARM_INPUTS = (2, 1)
MARKER = 4

Course = Callable[[np.ndarray], np.ndarray]
"""Factor, or rate, at times from the first marker on, seconds."""


def steady(value: float) -> Course:
    return lambda time: np.full(time.shape, value)


def patterns_of(folder: Path, light: str, masks: int = 10) -> Patterns:
    """Random masks on a small device, of a design that knows how bright its scenes are."""
    rng = np.random.default_rng(2)
    rails = rng.random((2, masks, 6))
    if light == "two-arm":
        rails = np.stack([rails[0], 1 - rails[0]]) / masks
    else:
        rails /= 2 * masks * rails.max(axis=2, keepdims=True)
    design = DesignRails(rails, light, SHAPE, summed_reflectance=3.0, brightness=BRIGHTNESS)
    return Patterns.from_rails(design, DEVICE, DWELL).write(folder)


@dataclass
class Lit:
    """A recording of random scenes, and the course of its light.

    Attributes
    ----------
    rates : array, shape (S, F, arms)
        Counts/s of each input in each frame, at the lamp's full light, without background.
    lamp : course
        Factor of the light of the scenes.
    stray : course
        Background of all inputs, counts/s.
    """

    patterns: Patterns
    flux: float
    rates: np.ndarray
    rng: np.random.Generator
    lamp: Course = field(default_factory=lambda: steady(1.0))
    stray: Course = field(default_factory=lambda: steady(200.0))

    @classmethod
    def sound(cls, patterns: Patterns, rng: np.random.Generator) -> "Lit":
        arms = 2 if patterns.manifest.two_arm else 1
        scenes, flux = int(rng.integers(6, 20)), float(10 ** rng.uniform(5.7, 6.5))
        x = rng.uniform(0.2, 1, (scenes, 6))
        x *= rng.normal(1, WITHIN, scenes).clip(0.88, 1.12)[:, None] / x.sum(axis=1, keepdims=True)
        lit = cls(patterns, flux, split(patterns, x * flux, arms), rng)
        lit.stray = steady(float(10 ** rng.uniform(1, 4)))
        return lit

    @property
    def scenes(self) -> int:
        return len(self.rates)

    @property
    def pass_s(self) -> float:
        return self.patterns.manifest.pass_s

    def starts(self) -> np.ndarray:
        """Starts of frames (S, F) after the first marker, seconds."""
        begins = np.arange(self.scenes) * self.pass_s
        pictures = self.patterns.manifest.picture_s
        return begins[:, None] + np.cumsum(pictures) - pictures

    def record(self, folder: Path, patterns_folder: Path) -> None:
        """Write the folder of the acquisition."""
        starts, rng = self.starts(), self.rng
        inputs = ARM_INPUTS[: self.rates.shape[2]]
        given = {
            "exposure_s": 0.9 * DWELL * len(self.patterns.manifest.mask_frames),
            "settle_s": SETTLE,
        }
        wanted = named(self.scenes, inputs=inputs, marker_bit=MARKER, **given)
        Recording.prepare(folder, Patterns.read(patterns_folder), wanted)
        grid = np.linspace(0, self.scenes * self.pass_s, 20_001)
        times, codes = [starts.ravel()], [np.full(starts.size, -MARKER)]
        for arm, each in enumerate(inputs):
            for rates, course in (
                (self.rates[..., arm], self.lamp),
                (np.ones(starts.shape), self.stray),
            ):
                most = 1.05 * course(grid).max()
                number = rng.poisson(rates * most * DWELL).ravel()
                came = np.repeat(starts.ravel(), number) + rng.random(number.sum()) * DWELL
                came = came[rng.random(len(came)) * most < course(came)]
                times.append(came)
                codes.append(np.full(len(came), each))
        write_photons(folder, np.concatenate(times) + 0.01, np.concatenate(codes))

    def errors(self, counts: Counts) -> np.ndarray:
        """Relative error (S,) of each scene's features by a steady lamp, without photon noise."""
        manifest, wrong, size = self.patterns.manifest, 0.0, 0.0
        gate = float(counts.lengths_s[0, 0])
        inside = SETTLE + (np.arange(40) + 0.5) / 40 * gate
        when = self.starts()[:, manifest.mask_frames, None] + inside
        lamp, stray = self.lamp(when).mean(axis=2), self.stray(when).mean(axis=2)
        for arm in range(self.rates.shape[2]):
            true = self.rates[:, manifest.mask_frames, arm]
            seen = true * lamp + stray - counts.dark_rate[:, [arm]]
            wrong = wrong + ((seen / counts.flux[:, None] - true / self.flux) ** 2).sum(axis=1)
            size = size + ((true / self.flux) ** 2).sum(axis=1)
        return np.sqrt(wrong / size)


def while_in(begin: float, end: float, inside: Course | float, usual: float) -> Course:
    """Something else within a time."""
    course = inside if callable(inside) else steady(inside)
    return lambda t: np.where((t >= begin) & (t < end), course(t), usual)


def lamp_off(lit: Lit) -> None:
    first = int(lit.rng.integers(lit.scenes))
    last = int(lit.rng.integers(first, lit.scenes)) + 1 if first else 1
    lit.lamp = while_in(first * lit.pass_s, last * lit.pass_s, 0.0, 1.0)


def lamp_steps(lit: Lit) -> None:
    """At a scene or within one, down or up."""
    at = lit.pass_s * lit.rng.uniform(0.5, lit.scenes - 0.5)
    at = at if lit.rng.random() < 0.3 else round(at / lit.pass_s) * lit.pass_s
    factor = lit.rng.uniform(0.25, 0.6) ** lit.rng.choice([-1, 1])
    lit.lamp = while_in(at, np.inf, factor, 1.0)


def lamp_decays(lit: Lit) -> None:
    rate = np.log(lit.rng.uniform(1.5, 4)) / (lit.scenes * lit.pass_s)
    lit.lamp = lambda t: np.exp(-rate * t)


def lamp_flickers(lit: Lit) -> None:
    depth, hertz = lit.rng.uniform(0.2, 0.9), 10 ** lit.rng.uniform(1.5, 2.6)
    phase = lit.rng.uniform(0, 2 * np.pi)
    lit.lamp = lambda t: 1 + depth * np.sin(2 * np.pi * hertz * t + phase)


def lamp_sags(lit: Lit) -> None:
    """Within one pass, and back."""
    begin = lit.pass_s * int(lit.rng.integers(lit.scenes))
    depth = lit.rng.uniform(0.3, 0.8)
    sag = while_in(begin, begin + lit.pass_s, lambda t: 1 - depth * (t - begin) / lit.pass_s, 1.0)
    lit.lamp = sag


def stray_burst(lit: Lit) -> None:
    """In a part of one pass.

    A weaker one that begins and ends with a frame looks like another scene: these counts alone
    cannot tell, and what the design was trained for must.
    """
    begin = lit.pass_s * int(lit.rng.integers(lit.scenes))
    length = lit.pass_s * lit.rng.uniform(0.05, 0.6)
    begin += lit.rng.uniform(0, lit.pass_s - length)
    usual = lit.stray(np.zeros(1))[0]
    burst = usual + lit.flux * lit.rng.uniform(0.8, 3)
    lit.stray = while_in(begin, begin + length, burst, usual)


FAULTS = {
    fault.__name__: fault
    for fault in (lamp_off, lamp_steps, lamp_decays, lamp_flickers, lamp_sags, stray_burst)
}
