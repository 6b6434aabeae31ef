"""The paper's comparison of designs on spectra, those of Indian Pines.

Each labelled pixel is a scene whose "pixels" are its bands. The paper divides these at random;
since neighbours resemble each other, the same is done with a test part in blocks that are apart.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pydantic import TypeAdapter

from deepfsi.base.intervals import Difference, all_above, mean_of_trials
from deepfsi.report.accuracy import accuracy_figure
from deepfsi.report.style import INK, photons_text
from deepfsi.sweeps.results import Point, Results, accuracy_difference
from deepfsi_paper.experiment import Compared, Experiment, Finding, best, gains, no_gain
from deepfsi_paper.indian_pines.measures import Measures, measure
from deepfsi_paper.report.section import Claim, Picture, Table, english_list

NOTICED = 0.02
"""Difference in accuracy that counts as an advantage."""

RIVALS = {
    "gaussian": ("raster", "hadamard", "truncated-hadamard", "pca"),
    "poisson": ("raster", "hadamard", "truncated-hadamard", "pca", "control"),
}
"""The other designs of masks."""

CODES = {"hadamard": "HB", "truncated-hadamard": "TH"}
"""Multiplexed designs that do not depend on the scenes, and the paper's names of them."""

SHORT = {"gaussian": "AGN", "poisson": "PN"}
"""The paper's names of both noises."""

PAPER = (
    "The trends are those of MNIST: DeepFSI shows no clear advantage under read noise (AGN), and "
    "under photon noise (PN) it surpasses all methods that were designed for read noise. On MNIST "
    "designs that are not feature-specific gain nothing over raster scan under PN. The paper "
    "counts AVIRIS's 224 bands; the public corrected file has 200. It names no split; a random one "
    "is usual."
)
"""Finding of the paper."""

Chosen = Mapping[tuple[str, float], Point]
"""Points by design and budget."""


@dataclass(frozen=True)
class _Leakage:
    """Accuracy of DeepFSI in a random split and in blocks, and their difference."""

    random: float
    blocks: float
    difference: Difference


@dataclass(frozen=True)
class Numbers:
    """Numbers that claims, figures and tables share."""

    results: Results

    @property
    def of(self) -> str:
        """Name of the scene."""
        return str(self.results.recipe["data"])

    @cached_property
    def measures(self) -> Measures:
        """Numbers beyond accuracies."""
        return TypeAdapter(Measures).validate_python(self.results.extra)

    @property
    def splits(self) -> list[str]:
        """Names of the splits."""
        return list(self.measures.parts)

    @cached_property
    def compared(self) -> dict[tuple[str, str], Compared]:
        """DeepFSI less the best other design, by noise and split."""
        return {
            (noise, split): _advantage(best(self.results, noise=noise, split=split), RIVALS[noise])
            for noise in SHORT
            for split in self.splits
        }

    @cached_property
    def leakages(self) -> dict[float, _Leakage]:
        """Leakage by budget, where there are two splits."""
        return leakage(self.measures) if len(self.splits) == 2 else {}


def show(results: Results) -> Finding:
    """Figures, claims and tables, all with the name of the scene."""
    numbers = Numbers(results)
    return Finding(
        _found(numbers),
        tuple(_accuracy_picture(numbers, split) for split in numbers.splits),
        tuple(claims_of(numbers)),
        tuple(_tables(numbers)),
    )


def claims_of(numbers: Numbers) -> list[Claim]:
    """Claims of each split, and on the difference of both."""
    of, splits, compared = numbers.of, numbers.splits, numbers.compared
    claims = [_no_advantage(of, split, compared[("gaussian", split)]) for split in splits]
    for split in splits:
        chosen = best(numbers.results, noise="poisson", split=split)
        claims.append(_advantageous(of, split, compared[("poisson", split)], chosen))
    for split in splits:
        chosen = best(numbers.results, noise="poisson", split=split)
        claims += [
            no_gain(f"PN, {split} split: {label}", gains(chosen, design, "raster"))
            for design, label in CODES.items()
        ]
    if numbers.leakages:
        claims.append(_leakage_claim(of, numbers.leakages))
    return claims


def _advantage(chosen: Chosen, rivals: Sequence[str]) -> Compared:
    """DeepFSI less the best of the others, which validation pixels choose, by budget."""
    found = {}
    for (design, budget), point in sorted(chosen.items(), key=lambda item: item[0][1]):
        if design == "deepfsi":
            found[budget] = accuracy_difference(point, _rival(chosen, rivals, budget))
    return found


def _rival(chosen: Chosen, rivals: Sequence[str], budget: float) -> Point:
    others = [chosen[(rival, budget)] for rival in rivals if (rival, budget) in chosen]
    return max(others, key=lambda point: point.validation or 0.0)


def _no_advantage(of: str, split: str, compared: Compared) -> Claim:
    most = max(compared, key=lambda budget: compared[budget].mean)
    clear = [photons_text(b) for b, each in compared.items() if each.low > NOTICED]
    said = f"{of}: DeepFSI − best other at most {compared[most]} at {photons_text(most)} photons"
    if clear:
        said += f"; beyond {NOTICED} at {english_list(clear)}"
    return Claim(
        f"AGN, {split} split: DeepFSI has no clear advantage (less than {NOTICED}) at any budget",
        all_above([-each for each in compared.values()], -NOTICED),
        said,
    )


def _advantageous(of: str, split: str, compared: Compared, chosen: Chosen) -> Claim:
    least, most = (f(compared, key=lambda budget: compared[budget].mean) for f in (min, max))
    unclear = [
        f"{_rival(chosen, RIVALS['poisson'], budget).label} at {photons_text(budget)}"
        for budget, each in compared.items()
        if each.low <= 0
    ]
    said = (
        f"{of}: DeepFSI − best other lowest {compared[least]} at {photons_text(least)}, highest "
        f"{compared[most]} at {photons_text(most)} photons"
    )
    if unclear:
        said += f"; not clearly above {english_list(unclear)}"
    holds = all_above(compared.values())
    return Claim(
        f"PN, {split} split: DeepFSI is above every other design of masks at every budget",
        holds,
        said,
        "" if holds else "In bright light all designs come to what the classifier can do.",
    )


def leakage(measures: Measures) -> dict[float, _Leakage]:
    """Accuracy that a random split adds to DeepFSI under photon noise, by budget.

    Both accuracies, and their difference, are means over the classes that both splits test, each
    with its share of the scene: the two test parts hold the classes in other shares.
    """
    sizes = np.array(measures.sizes)
    rates = {(row.split, row.photons): np.array(row.rates, float) for row in measures.recalls}
    found = {}
    for photons in sorted({row.photons for row in measures.recalls}):
        one, other = (rates[(split, photons)] for split in measures.parts)
        both = np.isfinite(one).all(axis=0) & np.isfinite(other).all(axis=0)
        means = [np.average(each[:, both], axis=1, weights=sizes[both]) for each in (one, other)]
        apart = mean_of_trials((means[0] - means[1]).tolist())
        found[photons] = _Leakage(float(means[0].mean()), float(means[1].mean()), apart)
    return found


def _leakage_claim(of: str, leakages: dict[float, _Leakage]) -> Claim:
    bright = max(leakages)
    own = leakages[bright]
    return Claim(
        f"Ours: in bright light ({photons_text(bright)} photons, PN) a random split flatters "
        "DeepFSI",
        all_above([own.difference]),
        f"{of}: {own.random:.3f} random, {own.blocks:.3f} blocks, {own.difference}, over the "
        "classes that both test, by their shares of the scene",
        "The interval covers training seeds, for one draw of the blocks.",
    )


def _found(numbers: Numbers) -> str:
    of, leakages, bands = numbers.of, numbers.leakages, numbers.measures.bands
    parts = []
    for (noise, split), own in numbers.compared.items():
        most = max(own, key=lambda budget: own[budget].mean)
        parts.append(
            f"{SHORT[noise]}, {split} split: {own[most]} at most, at {photons_text(most)} photons"
        )
    text = (
        f"On {of}, DeepFSI less the best other design of masks, which validation pixels "
        f"choose: {'; '.join(parts)}. "
    )
    if leakages:
        bright = max(leakages)
        leak = leakages[bright]
        text += (
            f"At {photons_text(bright)} photons DeepFSI classifies {leak.random:.3f} of the test "
            f"pixels drawn at random and {leak.blocks:.3f} of those in blocks of their own "
            f"({leak.difference}), each class weighted by its share of the scene. "
        )
    return text + (
        f"The scene has {bands} bands (the paper counts 224), padded with darkness "
        f"to {numbers.results.data.image_shape[0]}. Pixels to choose the number of masks on are a "
        "random part of the training pixels under either split. Intervals cover training seeds for "
        "one draw of each split."
    )


def _accuracy_picture(numbers: Numbers, split: str) -> Picture:
    results, of, sizes = numbers.results, numbers.of, numbers.measures.sizes
    part = results.with_points(p for p in results.points if p.split == split)
    figure = accuracy_figure(part)
    figure.suptitle(f"{of}, {split} split", fontsize=10, fontweight="bold", color=INK)
    return Picture(
        figure,
        f"{of}, {split} split: accuracy against photons, each design at the number of "
        "masks that validation chooses. Circles are feature-specific designs. Bars: 95 % "
        f"intervals. Chance is one in {len(sizes)} classes; always naming the "
        f"largest class gives {max(sizes) / sum(sizes):.2f}.",
        f"Accuracy of all designs on {of}, {split} split; numbers in the table.",
    )


def _tables(numbers: Numbers) -> list[Table]:
    of, parts = numbers.of, numbers.measures.parts
    heads = ("split", "noise", "design", "photons", "masks", "accuracy", "low", "high")
    fields = ("split", "noise", "label", "photons", "masks", "accuracy", "low", "high")
    rows = [tuple(getattr(p, field) for field in fields) for p in numbers.results.points if p.best]
    tables = [
        Table(
            f"{of}: accuracy at the chosen number of masks, with 95 % intervals", heads, tuple(rows)
        ),
        Table(
            f"{of}: labelled pixels of each split; validation pixels are among the training ones",
            ("split", "training", "test", "left out beside test pixels", "classes tested"),
            tuple(
                (split, own.train, own.test, own.left_out, own.classes_tested)
                for split, own in parts.items()
            ),
        ),
    ]
    if numbers.leakages:
        tables.append(
            Table(
                f"{of}: DeepFSI's accuracy under photon noise by split, over the classes that both "
                "test, each with its share of the scene",
                ("photons", *parts, "difference", "low", "high"),
                tuple(
                    (photons, own.random, own.blocks, each.mean, each.low, each.high)
                    for photons, own in numbers.leakages.items()
                    for each in [own.difference]
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
)
