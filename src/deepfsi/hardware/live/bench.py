"""Virtual devices of a run, which see the scenes as a camera does."""

from functools import lru_cache
from pathlib import Path

import numpy as np

from deepfsi.base.progress import SILENT, Report
from deepfsi.hardware.counting.acquisition import Acquisition
from deepfsi.hardware.live.known import read_looks
from deepfsi.hardware.live.run import Bench
from deepfsi.hardware.patterns.folder import read_patterns
from deepfsi.hardware.virtual.bench import BenchCounter, BenchProjector, Latencies, VirtualSetup
from deepfsi.hardware.virtual.camera import (
    MirrorLight,
    VirtualCamera,
    arrival_rates,
    check_scenes,
    expected_events,
)


def virtual_bench(
    patterns: Path,
    scenes: np.ndarray,
    acquisition: Acquisition,
    latencies: Latencies,
    report: Report = SILENT,
) -> Bench[BenchProjector]:
    """Bench for scenes (S, h, w) with the camera, flux, seed and wiring of an acquisition."""
    camera = VirtualCamera.model_validate(acquisition.camera)
    if acquisition.live is not None and acquisition.live.background:
        scenes = np.concatenate([scenes, np.zeros_like(scenes[:1])])  # the last: no scene
    manifest, flux = read_patterns(patterns).manifest, acquisition.flux or 0.0
    images = check_scenes(scenes, manifest, flux)
    rates = arrival_rates(patterns, scenes, camera, flux, report)
    usual = {}
    if manifest.device.load_us:
        usual["load"] = manifest.device.load_us * 1e-6
    if manifest.looks:
        usual["decision"] = read_looks(patterns, manifest).decision_s
    latencies = Latencies(**usual | latencies.model_dump(include=latencies.model_fields_set))

    @lru_cache(maxsize=1)
    def light(scene: int) -> MirrorLight:
        return MirrorLight(manifest, images[scene][None], camera, flux)

    laboratory = VirtualSetup(
        rates,
        camera,
        latencies,
        acquisition.seed or 0,
        lambda scene, packed: light(scene).rates([packed])[0, 0],
    )
    return Bench(
        BenchProjector(laboratory),
        BenchCounter(laboratory, acquisition.inputs, acquisition.marker_bit),
        laboratory.display,
        lambda: laboratory.now_s,
        latencies.model_dump(),
    )


def most_events(patterns: Path, scenes: np.ndarray, acquisition: Acquisition) -> float:
    """Photons and dark counts that a virtual live run is expected to record, at most."""
    camera, known = VirtualCamera.model_validate(acquisition.camera), read_patterns(patterns)
    passes = acquisition.exposure_s / known.manifest.pass_s + 1
    return expected_events(known, scenes, camera, acquisition.flux or 0.0) * passes
