"""Recordings to test with: marker trains, their troubles, and photons that are known."""

import json
import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from deepfsi.base.errors import InputError
from deepfsi.camera.device import DEVICES, find_device
from deepfsi.counting.acquisition import Acquisition, Scene
from deepfsi.counting.events import PtuWriter
from deepfsi.counting.recording import Recording
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.manifest import Frame, Manifest
from deepfsi.patterns.rails import DesignRails

FUZZ = int(os.environ.get("DEEPFSI_FUZZ", "100"))
TICK = 1e-12
DWELL = 1e-3
JITTER = 2e-7

many = settings(
    max_examples=FUZZ,
    deadline=None,
    derandomize="DEEPFSI_FUZZ" not in os.environ,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def schedule(pictures: list[int]) -> Manifest:
    """Manifest of masks with these picture times, µs."""

    def frame(role: str, picture_us: int = 1000, **mask) -> Frame:
        return Frame(role=role, picture_us=picture_us, sha256="0" * 64, **mask)

    ends, share = (frame("on"), frame("off")), 1 / len(pictures)
    masks = [frame("mask", us, mask=i, rail="plus", share=share) for i, us in enumerate(pictures)]
    return Manifest(
        deepfsi="0",
        device=DEVICES["dlp7000"],
        image_shape=(4, 4),
        masks=len(masks),
        rails=1,
        light="free-dwell",
        dimmed=1,
        summed_reflectance=1,
        selection="ordered",
        mirrors_sha256="0" * 64,
        format="npy",
        frames=(*ends, *masks, *ends),
    )


def train(
    manifest: Manifest,
    scenes: int,
    drift: float = 0.0,
    offset: float = 0.02,
    pauses: float | list[float] = 0.0,
    seed: int = 0,
    extra: float = 0.0,
    jitter: float = JITTER,
) -> np.ndarray:
    """True starts of frames on the counter's clock, (S, F), with jitter.

    Each frame lasts 1 + `drift` times as long as planned, and `extra` seconds.
    """
    rng = np.random.default_rng(seed)
    gaps = np.broadcast_to(pauses, (scenes,))
    pictures = (1 + drift) * manifest.picture_s + extra
    begins = np.arange(scenes) * pictures.sum() + (1 + drift) * (np.cumsum(gaps) - gaps[0])
    starts = (1 + drift) * offset + begins[:, None] + np.cumsum(pictures) - pictures
    return starts + rng.uniform(-jitter, jitter, starts.shape)


@dataclass
class Trouble:
    kind: str
    scene: int
    frame: int
    amount: float

    def strike(self, markers: np.ndarray, true: np.ndarray) -> np.ndarray:
        scene, frame = self.scene % len(true), self.frame % true.shape[1]
        time = true[scene, frame]
        if not len(markers):
            return markers
        near = int(np.argmin(np.abs(markers - time)))
        there = np.array([near] if abs(markers[near] - time) < 10 * JITTER else [], int)
        if self.kind == "missing":
            return np.delete(markers, there)
        if self.kind == "late":
            return np.sort(np.append(np.delete(markers, there), time + self.amount * DWELL))
        return np.sort(np.append(markers, time + self.amount * DWELL))


def troubles(*kinds: str) -> st.SearchStrategy[list[Trouble]]:
    edges = st.sampled_from([0, 1, 2, -1, -2, -3])
    trouble = st.builds(
        Trouble,
        kind=st.sampled_from(kinds),
        scene=st.integers(0, 9),
        frame=st.one_of(edges, st.integers(0, 99)),
        amount=st.floats(-0.45, 0.95),
    )
    return st.lists(trouble, min_size=1, max_size=6)


def write_photons(folder: Path, times_s: np.ndarray, codes: np.ndarray) -> None:
    """Events in any order as the file of a run."""
    order = np.argsort(times_s, kind="stable")
    with PtuWriter(folder / "photons.ptu", TICK) as writer:
        writer.write(np.rint(times_s[order] / TICK).astype(np.int64), codes[order])


DEVICE = find_device("24x16")
SHAPE = (2, 3)


def patterns_of(
    folder: Path, light: str = "equal-dwell", file: bytes | None = b"not read", **settings
) -> Patterns:
    """Six random masks on a small device."""
    rng = np.random.default_rng(4)
    if light == "two-arm":
        part = rng.random((6, 6))
        rails = np.stack([part, 1 - part]) / 6
    elif light == "free-dwell":
        rails = rng.random((1, 6, 6)) * np.linspace(0.2, 1, 6)[:, None]
        rails /= rails.max(axis=2).sum()
    else:
        rails = rng.random((2, 6, 6))
        rails[0, 0], rails[1, 0] = 1.0, 0.0
        rails /= 11 * np.where(rails.any(axis=2), rails.max(axis=2), 1)[..., None]
    design = DesignRails(rails, light, SHAPE, summed_reflectance=2.0, file=file)
    return Patterns.from_rails(design, DEVICE, DWELL, **settings).write(folder)


def named(scenes: int, **settings) -> Acquisition:
    given = {"exposure_s": 5e-3, "settle_s": 2e-5, "repeats": 1, **settings}
    return Acquisition(scenes=tuple(Scene(name=f"scene {i}") for i in range(scenes)), **given)


def split(patterns: Patterns, light: np.ndarray, arms: int) -> np.ndarray:
    """Light (S, N) of scenes that each arm sees in each frame, (S, F, arms)."""
    part = np.zeros((len(patterns.manifest.frames), patterns.on.shape[1]))
    part[[0, -2]] = 1
    part[patterns.manifest.mask_frames] = patterns.fractions
    return np.stack([light @ part.T, light @ (1 - part.T)], axis=-1)[..., :arms]


def shining(patterns: Patterns, scenes: int) -> np.ndarray:
    """Photons (S, F, 1) of random scenes on one arm; at all ON some 1000, dark 3."""
    bright = np.random.default_rng(9).uniform(100, 200, (scenes, patterns.on.shape[1]))
    return np.rint(split(patterns, bright, 1)).astype(int) + 3


@dataclass
class Run:
    """A recording without faults, and what went into it."""

    folder: Path
    patterns: Patterns
    starts: np.ndarray
    photons: np.ndarray

    def copy(self, folder: Path) -> Self:
        shutil.copytree(self.folder, folder)
        return replace(self, folder=folder)

    def record(self, starts: np.ndarray, markers: np.ndarray, photons: np.ndarray) -> None:
        """Write photons (S, F, inputs) spread evenly over each frame, from 30 µs on to its end."""
        times, codes = [markers], [np.full(len(markers), -4)]
        length = self.patterns.manifest.picture_s
        for column, each in enumerate((2, 1)[: photons.shape[-1]]):
            for (scene, frame), many in np.ndenumerate(photons[..., column]):
                part = np.arange(many) / many
                times.append(starts[scene, frame] + 3e-5 + (length[frame] - 4e-5) * part)
                codes.append(np.full(many, each))
        times.append(np.linspace(0, markers.min() * 0.9, 50))  # before the first marker
        codes.append(np.zeros(50, int))
        write_photons(self.folder, np.concatenate(times), np.concatenate(codes))

    def edit(self, **changes) -> None:
        path = self.folder / "acquisition.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | changes))

    def refused(self, match: str, **settings) -> None:
        with pytest.raises(InputError, match=match) as error:
            Recording.read(self.folder).count(**settings)
        assert "\n" not in str(error.value)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Run:
    """A recording of three scenes on one arm, counted: do not change it."""
    home = tmp_path_factory.mktemp("whole")
    patterns = patterns_of(home / "patterns")
    asked = named(3, exposure_s=DWELL * 11 * 0.97, inputs=(2,), marker_bit=4)
    Recording.prepare(home / "run", Patterns.read(home / "patterns"), asked)
    starts = train(patterns.manifest, 3, 1.5e-4)
    run = Run(home / "run", patterns, starts, shining(patterns, 3))
    run.record(starts, starts.ravel(), run.photons)
    Recording.read(run.folder).count()
    return run


@pytest.fixture
def run(whole, tmp_path) -> Run:
    return whole.copy(tmp_path / "run")
