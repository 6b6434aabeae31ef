"""False alarms of every test of light, gain and consistency, and what each finds.

    python benchmarks/false_alarms.py

Sound draws obey what a test takes for granted, and nothing else: Poisson counts, scenes of one
spread of brightness, steady light. Each test is then shown one fault of a stated size. A rate of
0.001 is of a whole acquisition, one of 0.01 of a single scene.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Annotated, NamedTuple

import numpy as np
import torch
import typer
from scipy.stats import binomtest

import deepfsi
from deepfsi.adaptive.posterior import AdaptivePosterior
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.device import DEVICES
from deepfsi.counting.checks import LightMonitor, check_light
from deepfsi.counting.flux import FALSE_ALARMS, Arrivals
from deepfsi.designfile.distribution import REFUSED, UNSURE, ReadoutDistribution
from deepfsi.evaluation.confidence import find_distribution
from deepfsi.patterns.manifest import Brightness, Frame, Manifest

PASSES, MASKS, FRAME_S = 20, 10, 1e-3
FLUX, DARK = 1e6, 1e3
"""Counts/s of a mean scene with all mirrors ON, and of the dark."""

BRIGHTNESS = Brightness(low=0.87, high=1.14, between=1.03, within=0.05)
CERTAIN = 2e-9
"""Chance of what lies six standard deviations out, on both sides."""

PHOTONS, LOOKS = 1e4, 6


class Law(NamedTuple):
    """A test, the rate of false alarms that it states, and a fault that it is to find."""

    name: str
    stated: float
    fault: str
    alarm: Callable[[np.random.Generator, bool], bool]  # of a draw, sound or with the fault
    power: float = 0.9  # of faults, at least this share is found


def manifest_of(detectors: int = 1) -> Manifest:
    """Patterns of masks that are shown for a millisecond each."""
    ends = [Frame(role=role, picture_us=1000, sha256="0" * 64) for role in ("on", "off")]
    share = 1 / MASKS
    masks = [
        Frame(role="mask", mask=k, rail="plus", share=share, picture_us=1000, sha256="0" * 64)
        for k in range(MASKS)
    ]
    seen = None
    if detectors > 1:
        usual = (1 / detectors,) * detectors
        seen = DetectorMap(count=detectors, shares=(usual,), spread=(0.01,) * detectors)
    return Manifest(
        deepfsi="0",
        device=DEVICES["dlp7000"],
        image_shape=(4, 4),
        masks=MASKS,
        rails=1,
        light="free-dwell",
        dimmed=1,
        summed_reflectance=1,
        selection="ordered",
        mirrors_sha256="0" * 64,
        format="npy",
        frames=(*ends, *masks, *ends),
        brightness=BRIGHTNESS,
        detectors=seen,
    )


def drawn(
    rng: np.random.Generator,
    lamp: Callable[[np.ndarray], np.ndarray] | None = None,
    gains: tuple[float, ...] = (1.0,),
) -> tuple[np.ndarray, np.ndarray]:
    """Photons (P, F, D) of an acquisition, and seconds (P, F).

    The lamp is a factor of the time (P, F) in seconds.
    """
    frames, count = MASKS + 4, len(gains)
    time = (np.arange(PASSES)[:, None] * frames + np.arange(frames) + 0.5) * FRAME_S
    bright = rng.normal(1, 0.04, PASSES).clip(0.88, 1.12)
    shown = rng.uniform(0.3, 0.7, (PASSES, frames))
    shown[:, [0, -2]], shown[:, [1, -1]] = 1.0, 0.0
    light = FLUX * bright[:, None] * shown
    light = light * (1.0 if lamp is None else lamp(time))
    parts = rng.dirichlet(np.full(count, 2500.0 / count), PASSES)[:, None] * np.array(gains)
    rates = light[..., None] * parts + DARK
    seconds = np.full(time.shape, FRAME_S)
    return rng.poisson(rates * seconds[..., None]), seconds


def kinds(rng: np.random.Generator, detectors: int = 1, **course) -> set[str]:
    """Kinds of the faults of an acquisition's light."""
    photons, seconds = drawn(rng, **course)
    manifest = manifest_of(detectors)
    arrivals = Arrivals(manifest.frames, photons, photons, seconds)
    light = check_light(arrivals, manifest, range(detectors))
    return {fault.kind for fault in light.faults}


@cache
def sound(seed: int) -> frozenset[str]:
    """Kinds of the faults of a sound acquisition, which the tests of its light share."""
    return frozenset(kinds(np.random.default_rng(seed)))


def recorded(name: str, fault: str, kind: str, **course) -> Law:
    """One of the tests of the light of an acquisition, which share `FALSE_ALARMS`."""

    def alarm(rng: np.random.Generator, faulty: bool) -> bool:
        seen = kinds(rng, **course) if faulty else sound(int(rng.integers(2**32)))
        return kind in seen

    return Law(name, FALSE_ALARMS, fault, alarm)


def steps(time: np.ndarray) -> np.ndarray:
    """Light that falls to 0.7 in the middle of the acquisition, between two scenes."""
    return np.where(np.arange(PASSES)[:, None] < PASSES // 2, 1.0, 0.7) + 0 * time


def sags(time: np.ndarray) -> np.ndarray:
    """Light that is 0.6 of itself in the second half of one pass."""
    frame = np.arange(time.shape[1]) > time.shape[1] // 2
    return np.where((np.arange(PASSES)[:, None] == 7) & frame, 0.6, 1.0) + 0 * time


def gain(rng: np.random.Generator, faulty: bool) -> bool:
    """Alarm of the gains of 2 × 2 detectors; with the fault one has 0.8 of its usual."""
    gains = (0.8 if faulty else 1.0, 1.0, 1.0, 1.0)
    return "gain" in kinds(rng, detectors=4, gains=gains)


def live(rng: np.random.Generator, faulty: bool) -> bool:
    """Alarm of the light of a live run; with the fault one scene's light sags to 0.6."""
    photons, seconds = drawn(rng, sags if faulty else None)
    manifest, found = manifest_of(), False
    light, frames = LightMonitor(manifest, (0,), PASSES), manifest.frames
    for place in range(PASSES):
        parts = [
            Arrivals(
                frames[some],
                photons[place, some].astype(float),
                photons[place, some].astype(float),
                seconds[place, some],
            )
            for some in (slice(0, 2), slice(2, -2), slice(-2, None))
        ]
        found |= bool(light.begin(parts[0])[1]) | bool(light.end(parts))
    return found


@cache
def readouts() -> tuple[ReadoutDistribution, np.ndarray]:
    """Distribution of the readouts of training digits, and mean counts (n, 1, m) of test digits."""
    digits = deepfsi.load_dataset("digits")
    masks = np.random.default_rng(3).random((64, MASKS)) / MASKS
    light = digits.x_train.sum(axis=1).mean()
    train, test = ((x @ masks / light)[:, None] for x in (digits.x_train, digits.x_test))
    return find_distribution(torch.from_numpy(train), digits.y_train, 10), test


def consistent(rng: np.random.Generator, faulty: bool, whole: bool) -> bool:
    """Alarm of the counts of ten new digits, or of one; with the fault in reverse order."""
    known, rates = readouts()
    counts = rng.poisson(1e5 * rates[rng.choice(len(rates), 10 if whole else 1, replace=False)])
    if faulty:
        counts = counts[..., ::-1]
    found = known.test(counts, np.full(len(counts), 1e5), 0.0)
    return bool(found.refused if whole else found.unsure[0])


@cache
def adaptive() -> tuple[deepfsi.Design, torch.Tensor]:
    """A design of adaptive masks of digits, and test digits."""
    digits = deepfsi.load_dataset("digits")
    made = deepfsi.learn(digits, camera="dmd", design="adaptive", masks=LOOKS, photons=PHOTONS)
    return made, torch.from_numpy(digits.x_test)


@torch.no_grad()
def misfit(rng: np.random.Generator, faulty: bool) -> bool:
    """Alarm of the misfit of a new digit; with the fault its negative."""
    design, digits = adaptive()
    scene = digits[int(rng.integers(len(digits)))][None]
    scene = 1.3 - scene if faulty else scene
    state = AdaptivePosterior(
        design.prior_exposure.prior, 1, design.prior_exposure.optics_at(PHOTONS)
    )
    generator, total = torch.Generator().manual_seed(int(rng.integers(2**32))), 0.0
    for share in design.prior_exposure.settings.shares:
        masks, counts, _ = state.look_at(scene, share, generator)
        total += float(state.misfit(masks, counts, share))
        state.update(masks, counts, share)
    assert design.prior_exposure.usual_misfit is not None
    return design.prior_exposure.usual_misfit.p_value(total, LOOKS - 1, PHOTONS) < UNSURE


def main(
    draws: Annotated[int, typer.Option(min=10, help="sound draws of each test")] = 2000,
) -> None:
    """Print the table."""
    print("| test | states | sound draws with an alarm | rate, 95 % | fault | found |")
    print("| --- | --- | --- | --- | --- | --- |")
    for law in LAWS:
        alarms, found, tries = measured(law, draws)
        low, high = binomtest(alarms, draws).proportion_ci(0.95)
        print(
            f"| {law.name} | {law.stated:.0e} | {alarms} of {draws} | {low:.1e} to {high:.1e} | "
            f"{law.fault} | {found} of {tries} |",
            flush=True,
        )


def measured(law: Law, draws: int) -> tuple[int, int, int]:
    """Alarms of sound draws, faults that are found, and of how many."""
    rng, tries = np.random.default_rng(20), max(draws // 10, 10)
    alarms = sum(law.alarm(rng, False) for _ in range(draws))
    return alarms, sum(law.alarm(rng, True) for _ in range(tries)), tries


LAWS = (
    recorded("levels of the lamp", "0.7 of the light from a scene on", "level", lamp=steps),
    recorded("steadiness of a pass", "0.6 of the light in half a pass", "unsteady", lamp=sags),
    Law("gains of 2 × 2 detectors", CERTAIN, "one at 0.8", gain),
    Law("light of a live run", FALSE_ALARMS, "0.6 of the light in half a scene", live),
    Law("counts of a scene", UNSURE, "masks in reverse order", partial(consistent, whole=False)),
    Law("counts of ten scenes", REFUSED, "masks in reverse order", partial(consistent, whole=True)),
    Law("misfit of adaptive masks", UNSURE, "negative of the scene", misfit, 0.4),
)

if __name__ == "__main__":
    typer.run(main)
