"""Consistency of counts with a design's training, as `camera classify` says it."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from deepfsi.errors import InputError

if TYPE_CHECKING:
    from deepfsi.design.artifact import Design
    from deepfsi.design.consistency import Consistency
    from deepfsi.hardware.recording.counts import Counts

UNTESTED = (
    "not tested for what the design was trained for: its file holds no readouts of training, which "
    "needs 50 scenes of each class"
)
"""Remark on counts of a design without a distribution."""


@dataclass(frozen=True)
class TestedCounts:
    """Result of the test: entries of each scene and of all for JSON, and lines for a reader."""

    scenes: list[dict[str, Any]]
    summary: dict[str, Any] | None
    remarks: list[str]


def check_counts(
    design: "Design", counts: "Counts", usable: np.ndarray, budgets: np.ndarray, force: bool
) -> TestedCounts:
    """Test the counts of an acquisition for what the design was trained for.

    The exposures of a scene count as one of their budgets together.

    Shapes: usable (S, R); budgets (S,).
    """
    from deepfsi.design.consistency import REFUSED, UNSURE

    if design.distribution is None:
        untested: dict[str, Any] = {"consistency": None, "unsure": None}
        return TestedCounts([untested] * len(usable), None, [UNTESTED])
    often = usable.sum(axis=1)
    some = often > 0
    exposures = counts.by_readout(usable)
    signal = counts.signal().sum(axis=1, where=exposures)[some]
    dark = counts.background.clip(min=0) * exposures.sum(axis=1)
    background = (dark + counts.excess.sum(axis=1, where=exposures))[some]
    found = design.consistency(
        design.readouts(signal), (budgets * often)[some], design.readouts(background)
    )
    if found.refused and not force:
        raise InputError(f"{_refusal(found)}; --force classifies them all the same")
    chances = np.full(len(often), np.nan)
    chances[some] = found.exposures
    entries = [
        {"consistency": None if np.isnan(p) else float(p), "unsure": bool(p < UNSURE)}
        for p in chances
    ]
    rates = {"false_alarms": REFUSED, "false_alarms_unsure": UNSURE}
    summary = {key: held for key, held in asdict(found).items() if key != "exposures"}
    return TestedCounts(entries, {**summary, **rates}, list(_remarks(found)))


def _refusal(found: "Consistency") -> str:
    return (
        "these counts do not look like what this design was trained for (p = "
        f"{found.whole:.1g}; {found.brightness:.2f} times the counts of its mean scene at this "
        "budget): check the design, the order of frames, the scenes and their scale, and --photons"
    )


def _remarks(found: "Consistency") -> Any:
    from deepfsi.design.consistency import REFUSED, UNSURE

    if found.refused:
        yield _refusal(found)
    unsure = int(found.unsure.sum())
    if unsure:
        yield (
            f"unsure: {unsure} of {found.unsure.size} scenes do not look like those of the "
            f"training, where about {UNSURE * 100:.0f} in 100 is expected"
        )
    if found.alike < REFUSED:
        yield "the scenes are alike: but for brightness, only photon noise differs between them"
