"""Words of a page for those who do not know the design: how it counts, and what it is."""

from collections.abc import Mapping
from typing import Any

from deepfsi.report.style import photons_text
from deepfsi.report.terms import LAWS

Payload = Mapping[str, Any]
"""What `design.payload.playable` makes."""

RAILS = {
    1: "Non-negative: each mask has one rail, and the network does any subtraction.",
    2: "Signed: each mask has a positive and a negative rail, which are counted separately.",
}
"""Words for masks of so many rails."""


def masks_text(payload: Payload) -> str:
    """Number of masks."""
    count = payload["matrix"]["shape"][0]
    return "1 mask" if count == 1 else f"{count} masks"


def detectors_text(payload: Payload) -> str:
    """Number of detectors, and which light each of them has."""
    # The law `column` divides the light, and what is divided is counted at the same time
    light, parts = payload["light"], payload["detectors"]
    counts = {"two-arm": 2, "column": payload["rails"] * payload["matrix"]["shape"][0]}
    kinds = {"two-arm": "one on each arm", "column": f"one for {_readout(payload)}"}
    words = [kinds[light]] if light in kinds else []
    words += ["each on its part of the scene"] if parts > 1 else []
    return ", ".join([str(parts * counts.get(light, 1)), *words])


def _readout(payload: Payload) -> str:
    return "each rail of each mask" if payload["rails"] == 2 else "each mask"


def way_text(payload: Payload) -> str:
    """Sentences on the way in which the camera counts."""
    light, looks = payload["light"], payload["exposure"].get("looks")
    if light == "column":
        return (
            f"Its optics split the light of each pixel among {masks_text(payload)} at once, with "
            f"a detector for {_readout(payload)}; no single mirror device does this."
        )
    many = payload["detectors"]
    counting = "one detector counts" if many == 1 else f"{many} detectors count"
    words = "A device of small mirrors shows one pattern, a mask, after another" + (
        ". Each mirror sends its light in one of two directions, and detectors in both count "
        "single photons."
        if light == "two-arm"
        else f", and {counting} the photons that each lets through."
    )
    if looks:
        words += (
            f" It goes through its masks {looks} times, and each time it chooses from the counts "
            "so far for how long to show each mask."
        )
    return words


def facts_of(payload: Payload) -> list[tuple[str, str]]:
    """Name and words of what is to be known about a design."""
    budget, test, exposure = payload["budget"], payload["test"], payload["exposure"]
    ends = dict.fromkeys(photons_text(budget[end]) for end in ("low", "high")) if budget else ()
    hidden = [str(layer["weight"]["shape"][0]) for layer in payload["network"][:-1]]
    facts = {
        "Data": f"{payload['data']['name']}. {payload['data']['preprocessing']}",
        "Masks": f"{masks_text(payload)}. {RAILS[payload['rails']]}",
        "Detectors": f"{detectors_text(payload)}.",
        "Light law": f"{payload['light']}: {LAWS[payload['light']]}.",
        "Learned for": f"{' to '.join(ends)} photons." if ends else "",
        "Noise": "Exact Poisson counts. There are no dark counts, no dead time and no stray light.",
        "Network": f"Fully connected, hidden layers of {' and '.join(hidden) or 'no'} units.",
        "Nested": f"The first {exposure['nested']} masks are enough for an answer."
        if exposure.get("nested")
        else "",
        "Probabilities": _calibrated(payload),
        "Stopping": _stopping(payload),
        "Accuracy": f"Share of {test['images']} test scenes that are classified rightly, with "
        f"{test['draws']} noise draw{'s' if test['draws'] > 1 else ''} of each. The bars are 95 % "
        f"intervals over {test['covers']}. Circles are measured; the line joins them.",
    }
    return [(name, words) for name, words in facts.items() if words]


def _calibrated(payload: Payload) -> str:
    """Words for the light at which probabilities say how often an answer is right."""
    known = payload["temperatures"]
    if known is None:
        return "Not calibrated: the network may be surer than it is right."
    return (
        "Calibrated at each light, so that they say how often such an answer is right for scenes "
        f"like those of the training. Below {photons_text(known['dimmest'])} photons there is too "
        "little light for this design."
    )


def _stopping(payload: Payload) -> str:
    """Words for the rule by which an exposure stops, if there is one."""
    if not payload["rules"]:
        return "This design has no rule for stopping early."
    return (
        "An exposure may stop as soon as the probability of its answer is above a threshold. "
        "It is chosen on scenes that the training left out, so that the accuracy on them stays "
        "that of whole exposures. It holds near the light that it was chosen at, and where it was "
        "not chosen no stop is offered."
    )
