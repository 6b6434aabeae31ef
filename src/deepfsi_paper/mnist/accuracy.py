"""The paper's comparison of designs on MNIST, under read noise and under photon noise."""

import math
from collections.abc import Iterable
from itertools import product

from deepfsi.base.intervals import Difference, all_above
from deepfsi.report.accuracy import accuracy_figure
from deepfsi.report.style import photons_text
from deepfsi.sweeps.results import Point, Results
from deepfsi_paper.experiment import (
    NOTHING,
    Compared,
    Experiment,
    Finding,
    best,
    gains,
    no_gain,
)
from deepfsi_paper.mnist.figures import error_figure
from deepfsi_paper.report.section import Claim, Picture, Table, english_list

STARVED = 1e6
"""Photons below which the paper's figure tells the designs apart under photon noise."""

MUCH = 0.05
"""Difference in accuracy that counts as much better."""

PAPER = (
    "Under read noise (AGN) FSI and DeepFSI are much better than the other codes, DeepFSI is above "
    "FSI and nearest to impulse imaging, and every code is above raster scan. Under photon noise "
    "(PN) codes that are not feature-specific gain nothing over raster scan; FSI is above them, "
    "DeepFSI above FSI, and the control group, masks of AGN with a classifier for PN, falls short "
    "of DeepFSI. Impulse imaging is the upper bound of all, and a higher throughput of light does "
    "not guarantee a better performance."
)


def show(results: Results) -> Finding:
    """Figures, claims and tables of the comparison."""
    photon, read = (best(results, noise=noise) for noise in ("poisson", "gaussian"))
    claims = (*photon_claims(photon), *read_claims(read))
    low, high = (f(budget for _, budget in photon) for f in (min, max))
    middle = min((b for _, b in photon), key=lambda b: abs(b - 1e4))
    at = {design: point for (design, budget), point in photon.items() if budget == middle}
    order = sorted(at.values(), key=lambda point: -point.accuracy)
    ranks = ", ".join(f"{point.label} {point.accuracy:.3f}" for point in order)
    holding = sum(claim.holds is True for claim in claims)
    found = (
        f"{holding} of {len(claims)} claims hold as stated. At {photons_text(middle)} photons "
        f"under PN: {ranks}. From {photons_text(low)} to {photons_text(high)} photons the best "
        "number of masks was chosen for each design and budget on validation images; the table of "
        "claims says where the paper and these numbers differ."
    )
    photons_words = "Accuracy of all designs against the photon budget; numbers in the table."
    error_words = "Accuracy of all designs against the impulse-imaging error, AGN and PN."
    chosen = [point for point in results.points if point.best]
    pictures = [
        Picture(
            error_figure(results),
            "Accuracy against the error of impulse imaging, which both noises share as an axis. "
            "Circles are feature-specific designs. Bars: 95 % intervals.",
            error_words,
        )
    ]
    for noise, name in (("poisson", "photon noise"), ("gaussian", "read noise")):
        part = results.with_points(point for point in chosen if point.noise == noise)
        caption = f"The same against photons, {name}."
        pictures.append(Picture(accuracy_figure(part), caption, photons_words))
    return Finding(found, tuple(pictures), claims, (_accuracies(results),))


def _claim(text: str, compared: Compared) -> Claim:
    """Claim that all differences are above 0."""
    least = min(compared, key=lambda budget: compared[budget].low)
    unclear = [photons_text(b) for b, each in compared.items() if each.low <= 0]
    said = f"lowest: {compared[least]} at {photons_text(least)} photons"
    if unclear:
        said += f"; not clearly above at {english_list(unclear)}"
    return Claim(text, all_above(compared.values()), said)


Chosen = dict[tuple[str, float], Point]
"""Points at their chosen number of masks, by design and budget."""

Pairs = dict[tuple[str, str, float], Difference]
"""Accuracies of one design less those of another, by both and the budget."""


def _pairs(
    chosen: Chosen, ones: Iterable[str], others: Iterable[str], below: float = math.inf
) -> Pairs:
    """Each of some designs less each of others, at all budgets below a bound."""
    return {
        (one, other, budget): each
        for one, other in product(ones, others)
        for budget, each in gains(chosen, one, other, below).items()
    }


def _all_pairs(
    text: str, chosen: Chosen, pairs: Pairs, limit: float = 0.0, why: str = "", more: str = ""
) -> Claim:
    """Claim that all pairs are above a limit, and why where they are not."""
    one, other, budget = least = min(pairs, key=lambda pair: pairs[pair].low)
    first, second = (chosen[(design, budget)].label for design in (one, other))
    holds = all_above(pairs.values(), limit)
    said = f"lowest: {first} − {second} {pairs[least]} at {photons_text(budget)} photons{more}"
    return Claim(text, holds, said, "" if holds else why)


def _bound(noise: str, chosen: Chosen, why: str = "") -> Claim:
    """Claim that impulse imaging is the upper bound."""
    designs = sorted({design for design, _ in chosen} - {"impulse"})
    return _all_pairs(
        f"{noise}: impulse imaging is the upper bound (no design is above it by {NOTHING})",
        chosen,
        _pairs(chosen, ["impulse"], designs),
        -NOTHING,
        why,
    )


def _throughput(chosen: Chosen) -> Claim:
    """Claim that a code which counts more light may be worse."""
    below = photons_text(STARVED)
    text = f"PN: FSI and DeepFSI are above HB, which counts more light, below {below} photons"
    pairs = {
        pair: each
        for pair, each in _pairs(chosen, ["pca", "deepfsi"], ["hadamard"], STARVED).items()
        if chosen[(pair[0], pair[2])].throughput < chosen[(pair[1], pair[2])].throughput
    }
    if not pairs:
        return Claim(text, None, "they do not count less light than HB")
    codes = [chosen[(code, budget)].throughput for code, _, budget in pairs]
    basis = [chosen[(other, budget)].throughput for _, other, budget in pairs]
    more = f"; they count {min(codes):.2f} to {max(codes):.2f} of the light, HB {max(basis):.2f}"
    return _all_pairs(text, chosen, pairs, more=more)


def _dimmer_half(chosen: Chosen) -> float:
    """Highest budget of the dimmer half."""
    budgets = sorted({budget for _, budget in chosen})
    return budgets[(len(budgets) - 1) // 2]


def photon_claims(photon: Chosen) -> list[Claim]:
    """Claims under photon noise, from points by design and budget."""
    half = _dimmer_half(photon)
    return [
        _claim(
            f"PN: DeepFSI is above FSI at every budget below {photons_text(STARVED)}",
            gains(photon, "deepfsi", "pca", STARVED),
        ),
        _claim(
            f"PN: FSI is above TH at every budget below {photons_text(STARVED)}",
            gains(photon, "pca", "truncated-hadamard", STARVED),
        ),
        no_gain(
            "PN: HB",
            gains(photon, "hadamard", "raster"),
            "Their reconstruction errors are equal in the mean over pixels, but the variance of "
            "raster scan follows each pixel's brightness, and in these images the strokes are the "
            "bright pixels; the variance of Hadamard is the same in all pixels, the dim "
            "background included.",
        ),
        no_gain(
            "PN: TH",
            gains(photon, "truncated-hadamard", "raster"),
            "TH spends all light on a few low frequencies, in which these images differ most. "
            "Truncation is prior knowledge about the scene.",
        ),
        _claim(
            "PN: the control group is below DeepFSI in the dimmer half "
            f"(up to {photons_text(half)} photons)",
            gains(photon, "deepfsi", "control", half * 1.001),
        ),
        _bound("PN", photon),
        _throughput(photon),
    ]


def read_claims(read: Chosen) -> list[Claim]:
    """Claims under read noise, from points by design and budget."""
    multiplexed = ("hadamard", "truncated-hadamard", "pca", "deepfsi")
    clear: list[tuple[str, float, Difference]] = []
    for design in multiplexed:
        for budget, each in gains(read, design, "raster").items():
            code, raster = read[(design, budget)], read[("raster", budget)]
            if code.low > raster.high or code.high < raster.low:
                clear.append((code.label, budget, each))
    against = [f"{label} at {photons_text(b)}" for label, b, each in clear if each.mean < 0]
    least = min((each for _, _, each in clear), key=lambda each: each.mean, default=None)
    singles = sorted({design for design, _ in read} - {"deepfsi", "impulse"})
    half = _dimmer_half(read)
    return [
        Claim(
            "AGN: every multiplexed code is above RS wherever their intervals are apart",
            None if least is None else all_above(each for _, _, each in clear),
            f"{len(clear)} cases apart, lowest {least}"
            + (f"; below: {english_list(against)}" if against else ""),
        ),
        _all_pairs(
            "AGN: DeepFSI is the highest of the designs of masks",
            read,
            _pairs(read, ["deepfsi"], singles),
            why="With much light several designs reach the limit of the classifier, and the order "
            "is chance; with very little light all are near guessing.",
        ),
        _all_pairs(
            f"AGN: FSI and DeepFSI are much better (by {MUCH}) than HB and TH in the dimmer half "
            f"(up to {photons_text(half)} photons)",
            read,
            _pairs(read, ["pca", "deepfsi"], ["hadamard", "truncated-hadamard"], half * 1.001),
            MUCH,
            "TH spends all light on a few low frequencies and comes near FSI before HB does.",
        ),
        _bound(
            "AGN",
            read,
            "Each readout has the same read noise: impulse imaging has that of a detector for each "
            "pixel, and a design of few masks that of few readouts.",
        ),
    ]


def _accuracies(results: Results) -> Table:
    heads = ("noise", "design", "photons", "masks", "accuracy", "low", "high", "light counted")
    fields = ("noise", "label", "photons", "masks", "accuracy", "low", "high", "throughput")
    rows = [tuple(getattr(p, field) for field in fields) for p in results.points if p.best]
    return Table("Accuracy at the chosen number of masks, with 95 % intervals", heads, tuple(rows))


EXPERIMENT = Experiment(
    name="mnist",
    title="Which design is most accurate, under read noise and under photon noise",
    paper=PAPER,
    show=show,
)
