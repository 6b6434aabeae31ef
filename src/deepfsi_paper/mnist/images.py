"""Accuracy over the number of training scenes."""

from collections import defaultdict
from collections.abc import Sequence

from deepfsi.base.intervals import accuracy_difference, all_above
from deepfsi.report.style import DESIGN_COLOURS, DESIGN_LINES, photons_text
from deepfsi.sweeps.results import Point, Results
from deepfsi_paper.experiment import Experiment, Finding
from deepfsi_paper.report.lines import Line, lines_figure
from deepfsi_paper.report.section import Claim, Picture, Table

PAPER = "The influence of training data size on performance is left for future investigation."

ENOUGH = 0.01
"""Accuracy below that of all scenes within which a number of scenes is enough."""

Places = dict[tuple[str, float, int], Point]
"""Points by design, photons and number of training scenes."""


def show(results: Results) -> Finding:
    """Accuracy of each design over the number of scenes, at the settings that validate best."""
    chosen = _chosen(results.points)
    most = max(images for *_, images in chosen)
    budgets = sorted({photons for _, photons, _ in chosen})
    designs = list(dict.fromkeys(design for design, *_ in chosen))
    enough = {
        (design, photons): _enough(chosen, design, photons)
        for design in designs
        for photons in budgets
        if (design, photons, most) in chosen
    }
    found = f"Within {ENOUGH} of all {most} scenes from: " + "; ".join(
        f"{_label(chosen, design)} {count} scenes ({photons_text(photons)} photons)"
        for (design, photons), count in enough.items()
    )
    table = Table(
        "Accuracy at the number of masks and epochs that is best on a sixth of the scenes",
        ("design", "photons", "scenes", "masks", "epochs", "trials", "accuracy", "low", "high"),
        tuple(
            (p.label, photons, images, p.masks, _epochs(p), p.trials, p.accuracy, p.low, p.high)
            for (_, photons, images), p in sorted(
                chosen.items(), key=lambda item: (designs.index(item[0][0]), *item[0][1:])
            )
        ),
    )
    return Finding(f"{found}.", (_picture(chosen, budgets),), _claims(chosen, budgets), (table,))


def _chosen(every: Sequence[Point]) -> Places:
    """Of the numbers of masks and epochs, those that validate best."""
    rivals = defaultdict(list)
    for point in every:
        images = int(str(point.recipe).rpartition("-")[2])
        rivals[(point.design, point.photons, images)].append(point)
    return {
        place: max(points, key=lambda point: point.validation or 0.0)
        for place, points in rivals.items()
    }


def _label(chosen: Places, design: str) -> str:
    return next(point.label for (name, *_), point in chosen.items() if name == design)


def _epochs(point: Point) -> str:
    return point.variant.removeprefix("epochs ")


def _enough(chosen: Places, design: str, photons: float) -> int:
    """Fewest scenes from which on accuracy stays within `ENOUGH` of that with all."""
    own = sorted(
        (
            (images, p.accuracy)
            for (n, b, images), p in chosen.items()
            if (n, b) == (design, photons)
        ),
        reverse=True,
    )
    fewest, whole = own[0]
    for images, accuracy in own:
        if accuracy < whole - ENOUGH:
            break
        fewest = images
    return fewest


def _claims(chosen: Places, budgets: Sequence[float]) -> tuple[Claim, ...]:
    claims = []
    for photons in budgets:
        lead = {
            images: accuracy_difference(point, chosen[("pca", photons, images)])
            for (design, budget, images), point in chosen.items()
            if (design, budget) == ("deepfsi", photons) and ("pca", photons, images) in chosen
        }
        if not lead:
            continue
        least = min(lead, key=lambda images: lead[images].low)
        claims.append(
            Claim(
                f"DeepFSI is above FSI with any number of scenes ({photons_text(photons)} photons)",
                all_above(lead.values()),
                f"lowest: {lead[least]} with {least} scenes",
            )
        )
    return tuple(claims)


def _thousands(scenes: float) -> str:
    """Short words for a number of scenes: 300, 3k, 60k."""
    return f"{scenes:.0f}" if scenes < 1000 else f"{scenes / 1000:g}k"


def _picture(chosen: Places, budgets: Sequence[float]) -> Picture:
    panels = {}
    for photons in budgets:
        lines = []
        for design in dict.fromkeys(design for design, *_ in chosen):
            own = [
                (images, p) for (n, b, images), p in chosen.items() if (n, b) == (design, photons)
            ]
            look = {
                "color": DESIGN_COLOURS[design],
                "linestyle": DESIGN_LINES[design],
                "marker": "o" if own[0][1].specific else "s",
                "markersize": 4,
                "linewidth": 1.4,
            }
            lines.append(Line.through(own[0][1].label, look, own))
        panels[f"training scenes ({photons_text(photons)} photons)"] = lines
    return Picture(
        lines_figure(panels, across=_thousands),
        "Accuracy against the number of training scenes, a sixth of which choose the number of "
        "masks and of steps. Bars: 95 % intervals.",
        "Accuracy against the number of training scenes, a line for each design; see the table.",
    )


EXPERIMENT = Experiment(
    name="images",
    title="How many training scenes",
    paper=PAPER,
    show=show,
)
