"""The paper's comparison of designs on spectra: Indian Pines, or a simulated scene that says so.

Each labelled pixel is a scene whose "pixels" are its bands. The paper divides these at random;
since neighbours resemble each other, the same is done with a test part in blocks that are apart.
"""

import base64
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from deepfsi.datasets import Dataset, SpectralImage, load_spectra
from deepfsi.datasets.indian_pines import SURROGATE, WATER, where
from deepfsi.design.artifact import Design
from deepfsi.design.evaluation import evaluate
from deepfsi.experiments.experiment import Experiment, Finding, Results, best
from deepfsi.experiments.indian_pines.figures import (
    class_maps_figure,
    overview_figure,
    spectral_masks_figure,
)
from deepfsi.optics.scanner import subtract
from deepfsi.report.comparison_page import listed, read_masks
from deepfsi.report.figures import INK, accuracy_figure, brightest, photons_text
from deepfsi.report.study_page import Claim, Picture, Table
from deepfsi.statistics.differences import Difference, above, difference, of_trials
from deepfsi.sweeps.queue import Report
from deepfsi.sweeps.recipe import Recipe

SCENES = ("indian-pines", "indian-pines-corrected", SURROGATE)
"""What may stand for the scene, best first."""

MAPPED = (1e2, 1e4, 1e6)
"""Budgets of the class maps, photons."""

SHOWN, CURVES = (1e2, 1e4, 1e8), 4
"""Budgets of the spectral masks, photons, and how many of each are drawn."""

BAND = 12
"""Band of the overview, from 1, as in the paper."""

PAIR = ("Corn-notill", "Woods")
"""Classes whose spectra are shown."""

NOTICED = 0.02
"""Difference in accuracy that counts as an advantage."""

RIVALS = {
    "gaussian": ("raster", "hadamard", "truncated-hadamard", "pca"),
    "poisson": ("raster", "hadamard", "truncated-hadamard", "pca", "control"),
}
"""The other designs with one detector."""

SHORT = {"gaussian": "AGN", "poisson": "PN"}
TRAINED, TESTED, LEFT_OUT = 1, 2, 3
"""What a labelled pixel is for; 0 has no label."""

PAPER = (
    "The trends are those of MNIST: DeepFSI shows no clear advantage under read noise (AGN), and "
    "under photon noise (PN) it surpasses all methods that were designed for read noise. The paper "
    "counts AVIRIS's 224 bands; the public file has 220. It names no split; a random one is usual."
)

Compared = dict[float, Difference]
Chosen = Mapping[tuple[str, float], Mapping[str, Any]]


def adapt(recipe: Recipe) -> Recipe:
    """The recipe on the first of `SCENES` that is at hand."""
    there = [name for name in SCENES if where(name)]
    if recipe.data != SCENES[0] or not there:
        return recipe
    return recipe.model_copy(update={"data": there[0]})


# ---------------------------------------------------------------- what is measured


def measure(
    results: Results, data: Dataset, designs: Path, workers: int | None, report: Report
) -> dict[str, Any]:
    """The scene itself, its parts, classes that DeepFSI gives to every pixel, and its masks."""
    scene = load_spectra(results["recipe"]["data"])
    splits = list(dict.fromkeys(point["split"] for point in results["points"]))
    extra: dict[str, Any] = {"scene": _overview(scene), "parts": {}, "maps": [], "masks": []}
    for number, split in enumerate(splits):
        report(number / len(splits), f"class maps, {split} split")
        uses = _uses(scene, split)
        uses = _uses(scene, split)
        extra["parts"][split] = {"uses": pack(uses), **_counts(scene, uses)}
        chosen = best(results, noise="poisson", split=split)
        for photons in MAPPED:
            if ("deepfsi", photons) in chosen:
                file = designs / f"{chosen[('deepfsi', photons)]['keys'][0]}.safetensors"
                seen = _class_map(Design.load(file), scene, data.pixels, photons)
                extra["maps"].append(
                    {
                        "split": split,
                        "photons": photons,
                        "map": pack(seen),
                        "train": float((seen == ranks(scene))[uses == TRAINED].mean()),
                        "test": float((seen == ranks(scene))[uses == TESTED].mean()),
                    }
                )
    extra["recalls"] = [row for split in splits for row in _recalls(results, scene, split, designs)]
    bands = scene.cube.shape[2]
    for photons in SHOWN:
        row: dict[str, Any] = {"photons": photons}
        for noise in SHORT:
            chosen = best(results, noise=noise, split=splits[0])
            if ("deepfsi", photons) in chosen:
                point = chosen[("deepfsi", photons)]
                rails = read_masks(designs / f"{point['keys'][0]}.safetensors")[0]
                first = brightest(rails, CURVES)
                row[noise] = (rails[0] - rails[1])[first, :bands].round(6).tolist()
                row[f"{noise}_masks"] = point["masks"]
        if all(noise in row for noise in SHORT):
            extra["masks"].append(row)
    return extra


def ranks(scene: SpectralImage) -> np.ndarray:
    """Place of each pixel's class among those present, from 1, (H, W); 0 where it has none."""
    present = np.unique(scene.labels[scene.labels != 0])
    return np.where(scene.labels != 0, np.searchsorted(present, scene.labels) + 1, 0)


def pack(values: np.ndarray) -> dict[str, Any]:
    """Small whole numbers 0 to 255 as JSON."""
    text = base64.b64encode(values.astype(np.uint8).tobytes()).decode()
    return {"shape": list(values.shape), "bytes": text}


def unpack(packed: Mapping[str, Any]) -> np.ndarray:
    """The array that was packed."""
    return np.frombuffer(base64.b64decode(packed["bytes"]), np.uint8).reshape(packed["shape"])


def _overview(scene: SpectralImage) -> dict[str, Any]:
    labels = ranks(scene)
    spectra = scene.scenes().reshape(*labels.shape, -1)
    band = spectra[..., min(BAND, spectra.shape[2]) - 1]
    names = scene.class_names
    shown = [name for name in PAIR if name in names] or list(names[:2])
    wavelengths = scene.wavelengths
    water = []
    if wavelengths is not None and len(wavelengths) == 220:
        gaps = np.split(WATER, np.flatnonzero(np.diff(WATER) > 1) + 1)
        water = [
            [float(f(wavelengths[part])) for f in (np.min, np.max)]
            for part in gaps
            if len(part) > 1
        ]
    return {
        "classes": list(names),
        "labels": pack(labels),
        "band": pack(np.rint(255 * band / band.max())),
        "band_nm": None
        if wavelengths is None
        else float(wavelengths[min(BAND, len(wavelengths)) - 1]),
        "bands": spectra.shape[2],
        "wavelengths": None if wavelengths is None else wavelengths.tolist(),
        "water": water,
        "spectra": {
            name: np.percentile(spectra[labels == names.index(name) + 1], (5, 50, 95), axis=0)
            .round(4)
            .tolist()
            for name in shown
        },
    }


def _uses(scene: SpectralImage, split: str) -> np.ndarray:
    train, test = scene.parts(split)
    return np.select([train, test, scene.labels != 0], [TRAINED, TESTED, LEFT_OUT], 0)


def _counts(scene: SpectralImage, uses: np.ndarray) -> dict[str, int]:
    return {
        "train": int((uses == TRAINED).sum()),
        "test": int((uses == TESTED).sum()),
        "left_out": int((uses == LEFT_OUT).sum()),
        "classes_tested": len(np.unique(scene.labels[uses == TESTED])),
    }


def _class_map(design: Design, scene: SpectralImage, bands: int, photons: float) -> np.ndarray:
    """Class of each labelled pixel after one exposure with photon noise, from 1; 0 elsewhere."""
    known = scene.labels != 0
    spectra = torch.from_numpy(scene.scenes(bands)[known.ravel()])
    scanner = design.scanner("poisson")
    with torch.no_grad():
        rates = scanner.rates(spectra / design.summed_reflectance) * photons
        counts = scanner.read(rates, torch.Generator().manual_seed(0))
        guess = design.logits(subtract(counts), photons).argmax(dim=-1)
    seen = np.zeros(known.shape, int)
    seen[known] = guess.numpy() + 1
    return seen


def _recalls(
    results: Results, scene: SpectralImage, split: str, designs: Path
) -> Iterator[dict[str, Any]]:
    """Accuracy of DeepFSI on the test pixels of each class, under photon noise."""
    data = scene.dataset(split, bands=results["data"]["image_shape"][0])
    for (design, photons), point in best(results, noise="poisson", split=split).items():
        if design == "deepfsi":
            trials = [
                evaluate(Design.load(designs / f"{key}.safetensors"), data, photons, seed=seed)
                for seed, key in enumerate(point["keys"])
            ]
            rates = [trial[0].rates for trial in trials]
            yield {"split": split, "photons": photons, "rates": rates}


# ---------------------------------------------------------------- what it shows


def show(results: Results) -> Finding:
    """Figures, claims and tables, all with the name of the scene."""
    name = results["recipe"]["data"]
    of = f"{name} (simulated)" if name == SURROGATE else name
    extra = results["extra"]
    splits = list(extra["parts"])
    compared = {
        (noise, split): _advantage(best(results, noise=noise, split=split), RIVALS[noise])
        for noise in SHORT
        for split in splits
    }
    claims = [
        *(_no_advantage(of, split, compared[("gaussian", split)]) for split in splits),
        *(
            _advantageous(
                of, split, compared[("poisson", split)], best(results, noise="poisson", split=split)
            )
            for split in splits
        ),
    ]
    if len(splits) == 2:
        claims.append(_leakage_claim(of, _leakage(extra, splits)))
        claims.append(_same_claim(of, results, splits))
    return Finding(
        _found(results, of, compared),
        tuple(_pictures(results, of, splits)),
        tuple(claims),
        tuple(_tables(results, of, splits)),
        title=f"Spectra instead of pictures: {name}"
        + (", a simulated scene" if name == SURROGATE else ""),
    )


def _advantage(chosen: Chosen, rivals: Sequence[str]) -> Compared:
    """DeepFSI less the best of the others, which validation pixels choose, by budget."""
    found = {}
    for (design, budget), point in sorted(chosen.items(), key=lambda item: item[0][1]):
        if design == "deepfsi":
            found[budget] = difference(point, _rival(chosen, rivals, budget))
    return found


def _rival(chosen: Chosen, rivals: Sequence[str], budget: float) -> Mapping[str, Any]:
    others = [chosen[(rival, budget)] for rival in rivals if (rival, budget) in chosen]
    return max(others, key=lambda point: point["validation"])


def _no_advantage(of: str, split: str, compared: Compared) -> Claim:
    most = max(compared, key=lambda budget: compared[budget].mean)
    clear = [photons_text(b) for b, each in compared.items() if each.low > NOTICED]
    said = f"{of}: DeepFSI − best other at most {compared[most]} at {photons_text(most)} photons"
    if clear:
        said += f"; beyond {NOTICED} at {listed(clear)}"
    return Claim(
        f"AGN, {split} split: DeepFSI has no clear advantage (less than {NOTICED}) at any budget",
        above([-each for each in compared.values()], -NOTICED),
        said,
    )


def _advantageous(of: str, split: str, compared: Compared, chosen: Chosen) -> Claim:
    least, most = (f(compared, key=lambda budget: compared[budget].mean) for f in (min, max))
    unclear = [
        f"{_rival(chosen, RIVALS['poisson'], budget)['label']} at {photons_text(budget)}"
        for budget, each in compared.items()
        if each.low <= 0
    ]
    said = (
        f"{of}: DeepFSI − best other lowest {compared[least]} at {photons_text(least)}, highest "
        f"{compared[most]} at {photons_text(most)} photons"
    )
    if unclear:
        said += f"; not clearly above {listed(unclear)}"
    holds = above(compared.values())
    return Claim(
        f"PN, {split} split: DeepFSI is above every other design with one detector at every budget",
        holds,
        said,
        "" if holds else "In bright light all designs come to what the classifier can do.",
    )


def _leakage(extra: Results, splits: Sequence[str]) -> dict[float, tuple[float, float, Difference]]:
    """What a random split adds to DeepFSI's accuracy under photon noise, by budget.

    Both accuracies, and their difference, are means over the classes that both splits test, each
    with its share of the scene: the two test parts hold the classes in other shares.
    """
    sizes = np.bincount(unpack(extra["scene"]["labels"]).ravel())[1:]
    rates = {
        (row["split"], row["photons"]): np.array(row["rates"], float) for row in extra["recalls"]
    }
    found = {}
    for photons in sorted({budget for _, budget in rates}):
        one, other = (rates[(split, photons)] for split in splits)
        both = np.isfinite(one).all(axis=0) & np.isfinite(other).all(axis=0)
        means = [np.average(each[:, both], axis=1, weights=sizes[both]) for each in (one, other)]
        apart = of_trials((means[0] - means[1]).tolist())
        found[photons] = (float(means[0].mean()), float(means[1].mean()), apart)
    return found


def _leakage_claim(of: str, leakage: dict[float, tuple[float, float, Difference]]) -> Claim:
    bright = max(leakage)
    one, other, apart = leakage[bright]
    return Claim(
        f"Ours: in bright light ({photons_text(bright)} photons, PN) a random split flatters "
        "DeepFSI",
        above([apart]),
        f"{of}: {one:.3f} random, {other:.3f} blocks, {apart}, over the classes that both test, "
        "by their shares of the scene",
        "The interval covers training seeds, for one draw of the blocks.",
    )


def _same_claim(of: str, results: Results, splits: Sequence[str]) -> Claim:
    """Whether what DeepFSI gains under photon noise depends on the split."""
    gains: list[dict[float, np.ndarray]] = []
    for split in splits:
        chosen = best(results, noise="poisson", split=split)
        budgets = sorted(budget for design, budget in chosen if design == "deepfsi")
        gains.append(
            {
                b: np.subtract(
                    chosen[("deepfsi", b)]["accuracies"],
                    _rival(chosen, RIVALS["poisson"], b)["accuracies"],
                )
                for b in budgets
            }
        )
    apart = {b: of_trials((gains[0][b] - gains[1][b]).tolist()) for b in gains[0]}
    most = max(apart, key=lambda budget: abs(apart[budget].mean))
    both = [*apart.values(), *(-each for each in apart.values())]
    return Claim(
        f"Ours: DeepFSI's advantage under PN is the same in both splits (within {NOTICED})",
        above(both, -NOTICED),
        f"{of}: random − blocks at most {apart[most]} at {photons_text(most)} photons",
    )


def _found(results: Results, of: str, compared: dict[tuple[str, str], Compared]) -> str:
    extra = results["extra"]
    parts = []
    for (noise, split), own in compared.items():
        most = max(own, key=lambda budget: own[budget].mean)
        parts.append(
            f"{SHORT[noise]}, {split} split: {own[most]} at most, at {photons_text(most)} photons"
        )
    text = ""
    if results["recipe"]["data"] == SURROGATE:
        text = (
            "These are not numbers of the real scene, whose cube was not at hand: "
            f"{SURROGATE} has simulated spectra on the real label map and bands. "
        )
    text += (
        f"On {of}, DeepFSI less the best other design with one detector, which validation pixels "
        f"choose: {'; '.join(parts)}. "
    )
    splits = list(extra["parts"])
    if len(splits) == 2:
        leakage = _leakage(extra, splits)
        bright = max(leakage)
        one, other, apart = leakage[bright]
        text += (
            f"At {photons_text(bright)} photons DeepFSI classifies {one:.3f} of the test pixels "
            f"drawn at random and {other:.3f} of those in blocks of their own ({apart}), each "
            "class weighted by its share of the scene. "
        )
    bands = extra["scene"]["bands"]
    return text + (
        f"The scene has {bands} bands (the paper counts 224), padded with darkness to "
        f"{results['data']['image_shape'][0]}. Pixels to choose the number of masks on are a "
        "random part of the training pixels under either split. Intervals cover training seeds for "
        "one draw of each split."
    )


def _pictures(results: Results, of: str, splits: Sequence[str]) -> list[Picture]:
    extra = results["extra"]
    scene = extra["scene"]
    names, labels = scene["classes"], unpack(scene["labels"])
    spectra = {each: np.array(rows) for each, rows in scene["spectra"].items()}
    nm = None if scene["wavelengths"] is None else np.array(scene["wavelengths"])
    at = "" if scene["band_nm"] is None else f", {scene['band_nm']:.0f} nm"
    pictures = []
    counts = np.bincount(labels.ravel())[1:]
    guess = f"always naming the largest class gives {counts.max() / counts.sum():.2f}"
    for split in splits:
        part = {**results, "points": [p for p in results["points"] if p["split"] == split]}
        figure = accuracy_figure(part)
        figure.suptitle(f"{of}, {split} split", fontsize=10, fontweight="bold", color=INK)
        pictures.append(
            Picture(
                figure,
                f"{of}, {split} split: accuracy against photons, each design at the number of "
                "masks that validation chooses. Circles are feature-specific designs. Bars: 95 % "
                f"intervals. Chance is one in {len(names)} classes; {guess}.",
                f"Accuracy of all designs on {of}, {split} split; numbers in the table.",
            )
        )
    pictures.append(
        Picture(
            overview_figure(
                unpack(scene["band"]), labels, names, spectra, nm, scene["water"],
                title=of, band_name=f"band {min(BAND, scene['bands'])}{at}",
            ),
            f"{of}: a band, the classes, their pixels, and the spectra of two (median, and 5 to "
            "95 % of pixels). Grey: bands that water vapour darkens.",
            f"Overview of {of}.",
        )
    )  # fmt: skip
    if extra["maps"]:
        rows = [{**row, "map": unpack(row["map"])} for row in extra["maps"]]
        uses = {split: unpack(extra["parts"][split]["uses"]) for split in splits}
        pictures.append(
            Picture(
                class_maps_figure(labels, names, rows, uses, title=of),
                f"{of}: the classes that DeepFSI gives to every labelled pixel after one exposure "
                "with photon noise, one design for each budget. Pixels that it was trained on are "
                "among them: above each map the accuracy on test and on training pixels.",
                f"Maps of classes that DeepFSI predicts on {of}, beside the truth.",
            )
        )
    if extra["masks"]:
        rows = [
            {**row, **{noise: np.array(row[noise]) for noise in SHORT}} for row in extra["masks"]
        ]
        pictures.append(
            Picture(
                spectral_masks_figure(rows, nm, scene["water"], title=f"{of}, {splits[0]} split"),
                f"{of}, {splits[0]} split: the spectral masks of DeepFSI that count most photons, "
                "as learned under each noise. A positive value sends that share of a band's "
                "photons to the detector while the mask's first rail is shown, a negative one "
                "while its second is. Grey: bands that water vapour darkens.",
                f"Curves of masks learned on {of} over wavelength.",
            )
        )
    return pictures


def _tables(results: Results, of: str, splits: Sequence[str]) -> list[Table]:
    heads = ("split", "noise", "design", "photons", "masks", "accuracy", "low", "high")
    fields = ("split", "noise", "label", "photons", "masks", "accuracy", "low", "high")
    rows = [tuple(p[field] for field in fields) for p in results["points"] if p["best"]]
    tables = [
        Table(
            f"{of}: accuracy at the chosen number of masks, with 95 % intervals", heads, tuple(rows)
        ),
        Table(
            f"{of}: labelled pixels of each split; validation pixels are among the training ones",
            ("split", "training", "test", "left out beside test pixels", "classes tested"),
            tuple(
                (split, own["train"], own["test"], own["left_out"], own["classes_tested"])
                for split, own in results["extra"]["parts"].items()
            ),
        ),
    ]
    if len(splits) == 2:
        leakage = _leakage(results["extra"], splits)
        tables.append(
            Table(
                f"{of}: DeepFSI's accuracy under photon noise by split, over the classes that both "
                "test, each with its share of the scene",
                ("photons", *splits, "difference", "low", "high"),
                tuple(
                    (photons, one, other, apart.mean, apart.low, apart.high)
                    for photons, (one, other, apart) in leakage.items()
                ),
            )
        )
    return tables


EXPERIMENT = Experiment(
    name="indian-pines",
    title="Spectra instead of pictures: Indian Pines",
    paper=PAPER,
    show=show,
    measure=measure,
    adapt=adapt,
)
