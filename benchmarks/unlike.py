"""Wrong and sure without a mark: pictures that are no digits, faults of the camera, and neither.

    python benchmarks/unlike.py                                   # two hours, one core
    python benchmarks/unlike.py --runs 2 --sound 0 --only turned  # a short look

Designs are learned on digits at 10⁴ photons. Test scenes, or other pictures, are shown with a
fault, and the counts of their frames are drawn. A cell says of 5, 12 and 40 scenes, the first of
one run, which share got a wrong class with a probability of 0.9 or more and no mark, and in
brackets which share was marked or refused. The last row says how many sound runs were refused, with
the 95 % interval at 40 scenes, and which shares of scenes of the others were marked, and wrong and
sure.
"""

import argparse
import csv
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import affine_transform
from scipy.stats import binomtest

import deepfsi
from deepfsi.base.errors import InputError
from deepfsi.base.progress import progress_bar
from deepfsi.camera.device import find_device
from deepfsi.counting.acquisition import Scene
from deepfsi.counting.checks import SPOILING
from deepfsi.counting.tables import TableSettings, column_names
from deepfsi.lab.design_data import design_rails
from deepfsi.lab.live import LiveRun
from deepfsi.lab.observer import SceneObserver
from deepfsi.lab.results import ClassifiedScene, FrameList, mark_early
from deepfsi.lab.virtual_optics import VirtualCamera, arrival_rates
from deepfsi.patterns.folder import Patterns

PHOTONS, EXPOSURE_S, SURE = 1e4, 10e-3, 0.9
FLUX, DARK = PHOTONS / EXPOSURE_S, 1e3
DESIGNS = {
    "recorded, one detector": {"camera": "dmd", "masks": 24},
    "recorded, 2 × 2": {"camera": "dmd-2x2", "masks": 12},
    "live, one detector": {"camera": "dmd", "masks": 24, "design": "adaptive"},
    "live, 2 × 2": {"camera": "dmd-2x2", "masks": 12, "design": "adaptive"},
}
FINE = 16
"""Points of a cell's side at which moved pictures are taken."""


class Case(NamedTuple):
    """What is shown, with what fault."""

    shown: Callable[[np.ndarray, np.random.Generator], np.ndarray] = lambda x, rng: x
    digits: bool = True  # else pictures that are of no class
    lit: Callable[[np.random.Generator], np.ndarray] = lambda rng: np.ones((8, 8))  # of cells
    dark: float = 1.0  # dark counts while masks are shown, over the usual ones
    counted: Callable[[np.ndarray], np.ndarray] | None = None  # (S, values), of tables alone
    marker: bool = False  # the first scene is black, and labelled so


def moved(
    x: np.ndarray, rng: np.random.Generator, turn: float = 0.0, scale: float = 1.0
) -> np.ndarray:
    """Pictures on black, turned by degrees about their centre, or scaled from a corner."""
    fine = np.kron(x, np.ones((1, FINE, FINE)))
    cos, sin = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    matrix = np.array([[cos, -sin], [sin, cos]]) / scale
    centre = (np.array(fine.shape[1:]) - 1) / 2
    offset = centre - matrix @ centre if turn else np.zeros(2)
    seen = np.stack([affine_transform(each, matrix, offset, order=0) for each in fine])
    return seen.reshape(len(x), x.shape[1], FINE, x.shape[2], FINE).mean(axis=(2, 4))


def objects(x: np.ndarray, rng: np.random.Generator, edges: int) -> np.ndarray:
    """Stars, squares or circles (with as many points; 0 of a circle), white on digits' black."""
    down, across = (np.indices((8 * FINE, 8 * FINE)) + 0.5) / FINE - 4
    out = np.empty_like(x)
    for picture in out:
        y, z = down - rng.uniform(-0.7, 0.7), across - rng.uniform(-0.7, 0.7)
        size, angle = rng.uniform(1.8, 3.2), np.arctan2(y, z) + rng.uniform(0, np.pi)
        if edges == 4:
            reach = size / np.maximum(abs(np.cos(angle)), abs(np.sin(angle)))
        else:  # a star's edge runs between two radii
            reach = size * (1 - 0.6 * abs((angle * edges / np.pi) % 2 - 1) * bool(edges))
        inside = np.hypot(y, z) < reach
        picture[:] = 0.3 + 0.7 * inside.reshape(8, FINE, 8, FINE).mean(axis=(1, 3))
    return out


SOUND = "nothing"
CASES = {
    "digits on white": Case(lambda x, rng: 1.3 - x),
    "black pictures": Case(lambda x, rng: 0 * x + 0.0, digits=False),
    "white pictures": Case(lambda x, rng: 0 * x + 1.0, digits=False),
    "even grey pictures": Case(lambda x, rng: 0 * x + 0.51, digits=False),
    "noise": Case(lambda x, rng: rng.uniform(0.3, 1, x.shape), digits=False),
    "stars": Case(partial(objects, edges=5), digits=False),
    "squares": Case(partial(objects, edges=4), digits=False),
    "circles": Case(partial(objects, edges=0), digits=False),
    "display lags by a scene": Case(lambda x, rng: np.roll(x, 1, axis=0)),
    "the same, and the first scene is dark": Case(
        lambda x, rng: np.roll(x, 1, axis=0), marker=True
    ),
    "each row of counts twice": Case(counted=lambda table: table[np.arange(len(table)) // 2 * 2]),
    "scale 7/8 from a corner": Case(partial(moved, scale=7 / 8)),
    "turned by 5°": Case(partial(moved, turn=5)),
    "turned by 15°": Case(partial(moved, turn=15)),
    "a column of mirrors OFF": Case(
        lit=lambda rng: (np.arange(8) != rng.integers(2, 6)) * np.ones((8, 1))
    ),
    "5 % of the mirrors OFF": Case(
        lit=lambda rng: rng.permutation(np.arange(64) > 2).reshape(8, 8)
    ),
    "saturated at the 90th percentile": Case(
        counted=lambda table: np.minimum(table, np.percentile(table[:, 2:-2], 90)).round()
    ),
    "ten times the dark counts in masks": Case(dark=10),
}


class Verdict(NamedTuple):
    """Of the scenes of a run, after 5, 12 and 40 of them (or so many)."""

    wrong: np.ndarray  # (sizes,), share with a wrong class, sure and without a mark
    marked: np.ndarray  # (sizes,), share that is marked or refused
    refused: np.ndarray  # (sizes,), bool


def verdict(answers: Sequence[Sequence[ClassifiedScene]]) -> Verdict:
    """Verdict on the answers after each size; none of a refused run."""
    wrong, marked, refused = [], [], []
    for scenes in answers:
        doubted = [
            any(fault.kind in ("early", "view") for fault in scene.faults) for scene in scenes
        ]
        bare = [scene.predicted is None or bool(scene.unlike) for scene in scenes]
        marks = np.array(doubted, bool) | np.array(bare, bool)
        sure = [
            scene.predicted != scene.label and (scene.probability or 0) >= SURE for scene in scenes
        ]
        wrong.append((sure & ~marks).mean() if scenes else 0.0)
        marked.append(marks.mean() if scenes else 1.0)
        whole = {fault.kind for scene in scenes for fault in scene.faults if fault.scene is None}
        refused.append(not scenes or bool(whole & set(SPOILING)))
    return Verdict(*map(np.array, (wrong, marked, refused)))


@cache
def frame_rates(patterns: Path) -> np.ndarray:
    """Counts/s (N, F, inputs) of each frame by each lit cell."""
    cells = np.eye(64).reshape(-1, 8, 8)
    return arrival_rates(Patterns.read(patterns), cells, VirtualCamera(), FLUX)


def recorded(
    patterns: Path, case: Case, light: np.ndarray, labels: list, sizes: Sequence[int], seed: int
) -> Verdict:
    """A recorded run of cells' light (S, N), as a table of the counts of each frame."""
    read, rng = Patterns.read(patterns), np.random.default_rng([seed, 1])
    manifest = read.manifest
    rates = np.einsum("sn,nfi->sfi", light, frame_rates(patterns)) + DARK
    rates[:, manifest.mask_frames] += (case.dark - 1) * DARK
    settle_s = manifest.device.settle_us * 1e-6
    table = rng.poisson(rates * (manifest.picture_s - settle_s)[:, None]).reshape(len(rates), -1)
    if case.counted is not None:
        table = case.counted(table).astype(int)
    answers = []
    for size in sizes:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "counts.csv"
            with file.open("w", newline="") as stream:
                rows = csv.writer(stream)
                rows.writerow(["scene", "label", *column_names(manifest)])
                named = enumerate(zip(labels[:size], table[:size].tolist(), strict=True))
                rows.writerows([str(k), label or "", *row] for k, (label, row) in named)
            answers.append(())
            with suppress(InputError):  # refused
                run = deepfsi.classify_table(patterns, file, TableSettings(settle_s=settle_s))
                answers[-1] = run.scenes[case.marker :]
    return verdict(answers)


def live(
    patterns: Path, case: Case, light: np.ndarray, labels: list, sizes: Sequence[int], seed: int
) -> Verdict:
    """A live run of cells' light (S, N)."""
    rng = np.random.default_rng([seed, 2])
    scenes = tuple(Scene(name=str(k), label=label) for k, label in enumerate(labels))
    run = LiveRun(Patterns.read(patterns), scenes, EXPOSURE_S)
    manifest = run.patterns.manifest
    cells = np.array(manifest.detectors.cells if manifest.detectors else [0] * 64)
    sees = np.arange(manifest.detector_count)[:, None] == cells  # (D, N)
    observer = SceneObserver(run.design, manifest, run.settings)

    def count(scene: int, asked: FrameList) -> np.ndarray:
        on = np.stack([np.ones(64), np.zeros(64)]) if asked.masks is None else asked.masks
        rates = (on[:, None] * sees) @ light[scene] * FLUX / manifest.summed_reflectance
        dark = DARK * (1 if asked.masks is None else case.dark)
        return rng.poisson((rates + dark) * asked.gate_ns[:, None] * 1e-9)

    answers = []
    for k, scene in enumerate(scenes):
        *_, last = observer.observe(k, partial(count, k))
        spoilt = {fault.kind for fault in last.faults} & set(SPOILING)
        best = None if spoilt else run.design.classes[last.probabilities.argmax()]
        answers.append(
            ClassifiedScene(
                name=scene.name,
                label=scene.label,
                predicted=best,
                probability=float(last.probabilities.max(initial=0)),
                faults=last.faults,
            )
        )
    return verdict([mark_early(answers[case.marker : size]) for size in sizes])


def measure(patterns: Path, name: str, count: int, seed: int) -> Verdict:
    """Verdict on a run of so many scenes."""
    rng, case = np.random.default_rng(seed), CASES.get(name, Case())
    data = deepfsi.load_dataset("digits")
    chosen = rng.permutation(len(data.x_test))[:count]
    x = data.x_test[chosen].reshape(-1, 8, 8).astype(float)
    labels = [data.classes[label] if case.digits else None for label in data.y_test[chosen]]
    if case.marker:
        x[0], labels[0] = 0, "dark"
    x = case.shown(x, rng)
    sizes = [size for size in (5, 12, 40) if size < count] + [count]
    kind = live if patterns.name.startswith("live") else recorded
    return kind(patterns, case, (x * case.lit(rng)).reshape(count, -1), labels, sizes, seed)


def learned(folder: Path, title: str, seed: int, **changed: int) -> Path:
    """Folder of the patterns of a design for digits."""
    data, patterns = deepfsi.load_dataset("digits"), folder / title
    if not patterns.exists():
        words = {**DESIGNS[title], "photons": PHOTONS, "seed": seed, **changed}
        rails = design_rails(deepfsi.learn(data, **words).save(folder / f"{title}.safetensors"))
        device = find_device("dlp7000")
        dwell_s = rails.picture_s(device, EXPOSURE_S)
        Patterns.from_rails(rails, device, dwell_s).write(patterns)
    return patterns


def cell(found: Sequence[Verdict], sound: bool) -> str:
    """Cell of the table, of some runs."""
    wrong, marked, refused = (np.array(each) for each in zip(*found, strict=True))
    if not sound:
        each = zip(wrong.mean(axis=0), marked.mean(axis=0), strict=True)
        return ", ".join(f"{share:.2f} ({marks:.2f})" for share, marks in each)
    low, high = binomtest(int(refused[:, -1].sum()), len(found)).proportion_ci(0.95)
    runs = ", ".join(map(str, refused.sum(axis=0)))
    kept = ~refused[:, -1]
    shares = f"{marked[kept, -1].mean():.3f}, {wrong[kept, -1].mean():.3f}"
    return f"{runs} [{low:.3f}, {high:.3f}]; {shares}"


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10, help="of each fault and camera")
    parser.add_argument("--sound", type=int, default=400, help="runs without a fault")
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--masks", type=int, help="of each design")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="faults and cameras whose names hold this")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--folder", type=Path, help="keep the designs here")
    given = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as place:
        folder = given.folder or Path(place)
        fewer = {} if given.masks is None else {"masks": given.masks}
        designs = [learned(folder, title, given.seed, **fewer) for title in DESIGNS]
        print("| what is wrong | " + " | ".join(path.name for path in designs) + " |")
        print("| --- " * (1 + len(designs)) + "|")
        rows = [name for name in (*CASES, SOUND) if given.only in name]
        pool = ProcessPoolExecutor(given.workers, get_context("spawn"))
        with pool, progress_bar(None, "runs") as report:
            for place, name in enumerate(rows):
                runs = given.sound if name == SOUND else given.runs
                first = given.seed + 1000 * [*CASES, SOUND].index(name)
                cells = []
                for part, patterns in enumerate(designs):
                    if patterns.name.startswith("live") and CASES.get(name, Case()).counted:
                        cells.append("–")
                        continue
                    run = partial(measure, patterns, name, given.scenes)
                    each = pool.map if given.workers > 1 else map
                    found = list(each(run, range(first, first + runs)))
                    cells.append(cell(found, name == SOUND) if found else "–")
                    report((place + (part + 1) / len(designs)) / len(rows), name)
                print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
