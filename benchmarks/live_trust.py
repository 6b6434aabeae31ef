"""What live runs answer when something is wrong: a table of faults, and false alarms without any.

    python benchmarks/live_trust.py                # half an hour, one core
    python benchmarks/live_trust.py --runs 100     # sound runs of 20 scenes too, an hour

A design of adaptive masks is learned on digits, and the same test scenes are shown to the virtual
camera in each case. Of each: the accuracy of the scenes that got a class, the share that got none,
and the share of all scenes that got a wrong class with a confidence above 0.9.
"""

import argparse
import itertools
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from deepfsi import learn, load_dataset
from deepfsi.base.errors import InputError
from deepfsi.base.progress import SILENT, Progress
from deepfsi.camera.device import find_device
from deepfsi.counting.acquisition import Scene
from deepfsi.datasets.dataset import Dataset
from deepfsi.lab.design_data import design_rails
from deepfsi.lab.devices import (
    LATENCIES,
    Setup,
    VirtualBench,
)
from deepfsi.lab.live import LiveRun
from deepfsi.lab.results import ClassifiedScene
from deepfsi.lab.virtual_detector import DETECTOR_TICK_S
from deepfsi.lab.virtual_optics import (
    EventRecorder,
    MirrorLight,
    VirtualCamera,
    arrival_rates,
)
from deepfsi.patterns.folder import Patterns

FLUX, EXPOSURE_S, PHOTONS = 1e7, 10e-3, 1e5
SURE = 0.9
BLACKOUT_S = 8e-3


@dataclass(frozen=True)
class Case:
    """What is wrong with a run."""

    camera: dict[str, float | bool] = field(default_factory=dict)
    lamp: tuple[float, float, float] = (1.0, 1.0, 1.0)  # before, from and at the end of the change
    ambient: float = 0.0  # in all-ON frames, over the scenes' mean light
    blackouts: int = 0


def step(to: float) -> Case:
    """A lamp that steps after half of the run."""
    return Case(lamp=(1.0, to, to))


CASES = {
    "sound": Case(),
    "50 ns dead time": Case(camera={"dead_time_s": 50e-9}),
    "100 ns dead time": Case(camera={"dead_time_s": 100e-9}),
    "100 ns dead time, paralysable": Case(camera={"dead_time_s": 100e-9, "paralysable": True}),
    "lamp steps to half": step(0.5),
    "lamp steps to double": step(2.0),
    "lamp steps to five times": step(5.0),
    "lamp fades by 80 %": Case(lamp=(0.0, 1.0, 0.2)),
    "100 blackouts of 8 ms": Case(blackouts=100),
    "ambient light as strong as the scenes": Case(ambient=1.0),
    "2 % of the light after half": step(0.02),
}


class Dimmed(EventRecorder):
    """Light that goes out at some times."""

    edges = np.zeros(0, np.int64)

    def see(self, durations: np.ndarray, rates: np.ndarray, report: Progress = SILENT) -> None:
        """Draw the events of pictures, none while the light is out."""
        ends = self.end + np.cumsum(durations)
        here = self.edges[(self.edges > self.end) & (self.edges < ends[-1])]
        for end in np.unique(np.concatenate([ends, here])).tolist():
            seen = rates[[int(np.searchsorted(ends, end))]]
            out = np.searchsorted(self.edges, end - 1, side="right") % 2
            super().see(np.array([end - self.end]), seen * (1 - out))


def lamp_of(case: Case, scenes: int) -> np.ndarray:
    """Light (S,) over the usual one."""
    before, first, last = case.lamp
    half = scenes // 2 if before else 0
    return np.concatenate([np.full(half, before), np.linspace(first, last, scenes - half)])


def run(
    patterns: Path, data: Dataset, case: Case, places: np.ndarray, seed: int
) -> list[ClassifiedScene]:
    """Answers for scenes."""
    x = data.x_test[places].reshape(-1, *data.image_shape)
    camera = VirtualCamera(**case.camera)
    dark, lamp = np.zeros_like(x[:1]), lamp_of(case, len(x))
    read = Patterns.read(patterns)
    rates = arrival_rates(read, x, camera, FLUX)
    ambient = VirtualCamera(ambient=FLUX)
    stray = arrival_rates(read, dark, ambient, FLUX)
    share = case.ambient * FLUX / stray[0, 0].sum()
    rates = (rates + share * stray) * lamp[:, None, None]
    manifest = read.manifest

    def made(scene: int, packed: np.ndarray) -> np.ndarray:
        seen = MirrorLight(manifest, x[scene][None], camera, FLUX).rates([packed])
        seen += share * MirrorLight(manifest, dark, ambient, FLUX).rates([packed])
        return lamp[scene] * seen[0, 0]

    named = tuple(
        Scene(name=str(k), label=data.classes[y]) for k, y in enumerate(data.y_test[places])
    )
    rng = np.random.default_rng(seed)
    took = len(x) * 50e-3  # a little more than such a run takes
    outs = rng.uniform(0, took, case.blackouts)
    setup = VirtualBench(rates, camera, LATENCIES, (0,), seed=seed, rates_of=made)
    setup.recorder = Dimmed(camera, np.random.default_rng(seed), (0,))
    edges = np.maximum.accumulate((np.sort(outs)[:, None] + [0, BLACKOUT_S]).ravel())
    setup.recorder.edges = np.rint(edges / DETECTOR_TICK_S).astype(np.int64)
    bench = Setup(setup, setup, setup.display, lambda: setup.now_s)
    live_run = LiveRun(read, named, EXPOSURE_S)
    with tempfile.TemporaryDirectory() as folder:
        steps = live_run.steps(Path(folder) / "run", bench)
        return [each.answer for each in steps if each.answer]


def row(name: str, found: list[ClassifiedScene]) -> str:
    """Row of the table."""
    told = [each for each in found if each.predicted is not None]
    right = np.mean([each.predicted == each.label for each in told]) if told else np.nan
    wrong = [each for each in told if each.predicted != each.label]
    sure = sum((each.probability or 0) > SURE for each in wrong)
    kinds = Counter(kind for each in found for kind in {fault.kind for fault in each.faults})
    words = ", ".join(f"{kind} {often}" for kind, often in kinds.most_common())
    none = 1 - len(told) / len(found)
    return f"| {name} | {right:.3f} | {none:.3f} | {sure / len(found):.3f} | {words} |"


def main() -> None:
    """Learn, run and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--looks", type=int, default=16)
    parser.add_argument("--runs", type=int, default=0, help="sound runs of 20 scenes")
    parser.add_argument("--only", help="cases whose names hold these words")
    parser.add_argument("--folder", type=Path, help="keep the design and its patterns here")
    given = parser.parse_args()
    data = load_dataset("digits")
    folder = given.folder or Path(tempfile.mkdtemp())
    design, patterns = folder / "adaptive.safetensors", folder / "patterns"
    if not patterns.exists():
        words = {"design": "adaptive", "masks": given.looks, "seed": given.seed}
        learn(data, camera="dmd", photons=PHOTONS, **words).save(design)
        device = find_device("64x48").model_copy(update={"load_us": 1000})
        Patterns.from_rails(design_rails(design), device, 1e-3).write(patterns)
    print("| what is wrong | accuracy | no class | wrong and sure | faults of scenes |")
    print("| --- | --- | --- | --- | --- |")
    places = np.random.default_rng(given.seed).permutation(len(data.x_test))[: given.scenes]
    for (name, case), seed in zip(CASES.items(), itertools.count(given.seed)):
        if given.only is None or given.only in name:
            try:
                print(row(name, run(patterns, data, case, places, seed)), flush=True)
            except InputError as error:
                print(f"| {name} | ended: {error} |", flush=True)
    alarms: Counter[str] = Counter()
    for seed in range(given.runs):
        places = np.random.default_rng([given.seed, seed]).permutation(len(data.x_test))[:20]
        found = run(patterns, data, Case(), places, 1000 + seed)
        kinds = [{fault.kind for fault in each.faults} for each in found]
        alarms.update(kind for each in kinds for kind in each)
        alarms["run"] += any(each - {"unsure"} for each in kinds)
    if given.runs:
        scenes = 20 * given.runs
        print(
            f"{given.runs} sound runs of 20 scenes: {alarms['unsure']} of {scenes} scenes unsure, "
            f"{alarms['run']} runs with any other fault ({dict(alarms)})"
        )


if __name__ == "__main__":
    main()
