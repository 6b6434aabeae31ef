"""Accuracy against clock time, to see when looks pay in time and when only in light.

    python benchmarks/clock.py -o runs/clock                           # hours on two cores
    python benchmarks/clock.py -o runs/clock --flux 1e6 --looks 1 4    # part of it
    python benchmarks/clock.py -o runs/clock --there --figure docs/figures/clock-time.png

Each frame of one device takes its dwell and the time in which the mirrors settle, and no picture is
shorter than the device's shortest one. Between two looks the loop takes a latency: the last frame's
counts have to come, the next dwells are decided, the device is triggered. So an exposure of light
time t with K looks and n frames takes

    T = t + n · settling time + (K − 1) · latency

of the clock. For each flux, light time and number of looks a design is trained that knows the
shortest dwell (`shortest_dwell`), on exact photon counts; one seed, nothing chosen, the test images
read once. One look is a fixed sequence. Raster scan shows one pixel after another and has a fixed
time for each. Finished trainings stay in the folder, and are not repeated.
"""

import argparse
import json
import math
from itertools import product
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from deepfsi import Dataset, Design, learn, load_dataset
from deepfsi.base.files import write_atomically
from deepfsi.base.numeric.intervals import wilson
from deepfsi.exposure.kind import Observation
from deepfsi.physics.laws import frames
from deepfsi.report.style import DESIGN_COLOURS, photons_text, styled

PICTURE_S, SETTLE_S = 44e-6, 10e-6
"""Shortest picture time and settling time of a DLP7000, seconds."""

LIGHT_S = [1e-3, 3e-3, 1e-2, 3e-2, 0.1, 1.0]
"""Light times, seconds."""

SHORTEST_S = PICTURE_S - SETTLE_S
"""Shortest dwell, seconds."""

LATENCIES = {0.0: "no latency", 1e-3: "1 ms a look", 0.1: "100 ms a look"}
"""Latencies of a look, seconds."""

RASTER = 0
"""In place of a number of looks: raster scan."""

LINES = {
    RASTER: ("raster scan", DESIGN_COLOURS["raster"], "s"),
    1: ("fixed sequence", DESIGN_COLOURS["impulse"], "o"),
    2: ("2 looks", DESIGN_COLOURS["pca"], "^"),
    4: ("4 looks", DESIGN_COLOURS["truncated-hadamard"], "v"),
    8: ("8 looks", DESIGN_COLOURS["deepfsi"], "D"),
}


def train(
    data: Dataset, photons: float, light_s: float, looks: int, masks: int, epochs: int
) -> Design:
    training = {"noise": "poisson", "batch": 500, "epochs": epochs, "hidden": (256, 128)}
    if looks == RASTER:
        return learn(
            data,
            design="raster",
            photons=photons,
            masks=data.pixels,
            camera={"light": "equal-dwell"},
            training=training,
            device="cpu",
        )
    return learn(
        data,
        photons=photons,
        masks=masks,
        camera={"shortest_dwell": SHORTEST_S, "exposure": light_s, "levels": 2},
        exposure={"looks": looks},
        training={**training, "start": "class-pairs", "lr": 5e-3},
        device="cpu",
    )


def test(design: Design, data: Dataset, photons: float) -> tuple[float, float]:
    """Accuracy on all test scenes, and the mean number of frames that an exposure shows."""
    scanner, generator = design.scanner(), torch.Generator().manual_seed(0)
    right, shown = 0, 0.0
    with torch.no_grad():
        for x, y in zip(
            torch.from_numpy(data.x_test).split(1000),
            torch.from_numpy(data.y_test).split(1000),
            strict=True,
        ):
            looks = list(design.observe(scanner, design.rates(scanner, x), generator, photons))
            right += int((design.logits_of(looks[-1], photons).argmax(dim=-1) == y).sum())
            shown += frames_shown(design, looks) * len(x)
    return right / len(data.y_test), shown / len(data.y_test)


def frames_shown(design: Design, looks: list[Observation]) -> float:
    """Frames of an exposure, in the mean over scenes."""
    if looks[-1].dwell is None:
        return float(len(frames(design.rails.stacked)))
    totals = torch.stack([torch.zeros_like(looks[0].dwell), *(seen.dwell for seen in looks)])
    return float((totals.diff(dim=0) > 0).float().sum(dim=(0, 2)).mean())


def path_of(folder: Path, point: dict[str, float], masks: int, epochs: int) -> Path:
    flux, light_s, looks = point["flux"], point["light_s"], int(point["looks"])
    return folder / f"{flux:g}-{light_s:g}-{looks}-{masks}-{epochs}.json"


def measure(folder: Path, data: Dataset, point: dict[str, float], masks: int, epochs: int) -> dict:
    """Accuracy and frames of one point, from the folder where they are already there."""
    path = path_of(folder, point, masks, epochs)
    if not path.exists():
        light_s, photons = point["light_s"], point["flux"] * point["light_s"]
        design = train(data, photons, light_s, int(point["looks"]), masks, epochs)
        accuracy, shown = test(design, data, photons)
        found = {**point, "accuracy": accuracy, "frames": shown, "images": len(data.y_test)}
        write_atomically(path, json.dumps(found).encode())
    return json.loads(path.read_text())


def clock_s(found: dict[str, float], latency_s: float) -> float:
    """Clock time of an exposure, seconds."""
    waits = max(int(found["looks"]) - 1, 0)
    return found["light_s"] + found["frames"] * SETTLE_S + waits * latency_s


def possible(light_s: float, looks: int, pixels: int) -> bool:
    """Raster scan has a frame for each pixel; a look has room for four frames at least."""
    least = pixels if looks == RASTER else 4 * looks
    return light_s >= least * SHORTEST_S


def table(results: list[dict[str, float]]) -> str:
    rows = ["| photons/s | light, ms | looks | frames | clock, ms | accuracy |", "| --- " * 6 + "|"]
    for found in results:
        low, high = wilson(found["accuracy"], int(found["images"]))
        name = LINES[int(found["looks"])][0]
        rows.append(
            f"| {found['flux']:g} | {found['light_s'] * 1e3:g} | {name} | {found['frames']:.0f} | "
            f"{clock_s(found, 0) * 1e3:.3g} | {found['accuracy']:.3f} [{low:.3f}, {high:.3f}] |"
        )
    return "\n".join(rows)


def reached(results: list[dict[str, float]], target: float) -> str:
    """Table of the clock times in which an accuracy is reached, between two light times each."""
    heads = [LINES[looks][0] for looks in LINES]
    rows = [f"| photons/s | latency | {' | '.join(heads)} |", "| --- " * (len(heads) + 2) + "|"]
    for flux, (latency, words) in product(fluxes_of(results), LATENCIES.items()):
        times = [reach(results, flux, looks, latency, target) for looks in LINES]
        cells = ["–" if math.isnan(time) else f"{time * 1e3:.3g}" for time in times]
        rows.append(f"| {flux:g} | {words} | {' | '.join(cells)} |")
    return "\n".join(rows)


def reach(
    results: list[dict[str, float]], flux: float, looks: int, latency: float, target: float
) -> float:
    """Clock time, seconds, at which an accuracy is reached; not a number if none of these is."""
    own = [found for found in results if found["flux"] == flux and found["looks"] == looks]
    if not own:
        return math.nan
    heights = np.maximum.accumulate([found["accuracy"] for found in own])
    times = np.log([clock_s(found, latency) for found in own])
    return float(np.exp(np.interp(target, heights, times, left=math.nan, right=math.nan)))


def fluxes_of(results: list[dict[str, float]]) -> list[float]:
    return sorted({found["flux"] for found in results})


@styled
def figure(results: list[dict[str, float]]) -> Figure:
    fluxes = fluxes_of(results)
    drawn = Figure(figsize=(3.1 * len(fluxes), 7.2), layout="constrained")
    axes = drawn.subplots(len(LATENCIES), len(fluxes), sharex=True, sharey=True, squeeze=False)
    for (row, (latency, words)), (column, flux) in product(
        enumerate(LATENCIES.items()), enumerate(fluxes)
    ):
        panel = axes[row, column]
        for looks, (name, colour, marker) in LINES.items():
            own = [f for f in results if f["flux"] == flux and f["looks"] == looks]
            times = [clock_s(found, latency) for found in own]
            heights = [found["accuracy"] for found in own]
            panel.plot(times, heights, color=colour, marker=marker, markersize=4, label=name)
        panel.set_title(f"{photons_text(flux)} photons/s, {words}")
        panel.set_xscale("log")
        panel.set_ylim(0, 1)
        panel.grid(True)
        panel.xaxis.set_major_formatter(FuncFormatter(lambda s, _: f"{s * 1e3:g}"))
    for panel in axes[-1]:
        panel.set_xlabel("clock time of an exposure, ms")
    for panel in axes[:, 0]:
        panel.set_ylabel("accuracy")
    drawn.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return drawn


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--data", default="mnist")
    parser.add_argument("--flux", type=float, nargs="+", default=[1e5, 1e6, 1e7])
    parser.add_argument("--light", type=float, nargs="+", default=LIGHT_S)
    parser.add_argument("--looks", type=int, nargs="+", default=list(LINES), help="0: raster scan")
    parser.add_argument("--masks", type=int, default=32)
    parser.add_argument("--epochs", type=int, default=8)
    parser.add_argument("--reach", type=float, default=0.85, help="accuracy of the second table")
    parser.add_argument("--there", action="store_true", help="show what is measured, and no more")
    parser.add_argument("--figure", type=Path)
    arguments = parser.parse_args(words)

    data = load_dataset(arguments.data)
    arguments.out.mkdir(parents=True, exist_ok=True)
    results = []
    for looks, light_s, flux in product(arguments.looks, arguments.light, arguments.flux):
        if possible(light_s, looks, data.pixels):
            point = {"flux": flux, "light_s": light_s, "looks": looks}
            how = arguments.masks, arguments.epochs
            if path_of(arguments.out, point, *how).exists() or not arguments.there:
                results.append(measure(arguments.out, data, point, *how))
    results.sort(key=lambda found: (found["flux"], found["light_s"], found["looks"]))
    print(table(results), reached(results, arguments.reach), sep="\n\n")
    if arguments.figure:
        figure(results).savefig(arguments.figure)


if __name__ == "__main__":
    main()
