"""Words of a page for those who do not know the design: how it counts, and what it is."""

from collections.abc import Mapping
from typing import Any

from deepfsi.camera import LIGHT_LAWS
from deepfsi.report.style import photons_text
from deepfsi.report.terms import LAWS

Payload = Mapping[str, Any]
"""What `evaluation.page_data.playable` makes."""

RAILS = {
    1: "Non-negative: each mask has one rail, and the network does any subtraction.",
    2: "Signed: each mask has a positive and a negative rail, which are counted separately.",
}
"""Words for masks of so many rails."""


def _is_adaptive(payload: Payload) -> bool:
    """True of a page of adaptive masks."""
    return "prior" in payload


def _masks(payload: Payload) -> int:
    return len(payload["shares"]) if _is_adaptive(payload) else payload["matrix"]["shape"][0]


def masks_text(payload: Payload) -> str:
    """Number of masks."""
    count, kind = _masks(payload), "adaptive mask" if _is_adaptive(payload) else "mask"
    return f"1 {kind}" if count == 1 else f"{count} {kind}s"


def detectors_text(payload: Payload) -> str:
    """Number of detectors, and which light each of them has."""
    # Where the light is divided, what is divided is counted at the same time
    law, parts = LIGHT_LAWS[payload["light"]], payload["detectors"]
    count, words = law.arms, ["one on each arm"] if law.arms == 2 else []
    if not law.in_turn:
        count, words = payload["rails"] * _masks(payload), [f"one for {_readout(payload)}"]
    words += ["each on its part of the scene"] if parts > 1 else []
    return ", ".join([str(parts * count), *words])


def _readout(payload: Payload) -> str:
    return "each rail of each mask" if payload["rails"] == 2 else "each mask"


def lead_text(payload: Payload) -> str:
    """Sentences that begin the page."""
    how = (
        "counts photons through masks, each made from all counts so far"
        if _is_adaptive(payload)
        else "counts photons through masks, and a small network reads the counts"
    )
    return f"This camera takes no picture: it {how}. Set a scene and its light, and press Expose."


def way_text(payload: Payload) -> str:
    """Sentences on the way in which the camera counts."""
    light, looks = payload["light"], payload.get("exposure", {}).get("looks")
    law = LIGHT_LAWS[light]
    if law.in_turn and not law.one_device:
        return f"{law.words.capitalize()}."
    if not law.in_turn:
        return (
            f"Its optics split the light of each pixel among {masks_text(payload)} at once, with "
            f"a detector for {_readout(payload)}; no single mirror device does this."
        )
    many = payload["detectors"]
    counting = "one detector counts" if many == 1 else f"{many} detectors count"
    words = "A device of small mirrors shows one pattern, a mask, after another" + (
        ". Each mirror sends its light in one of two directions, and detectors in both count "
        "single photons."
        if law.arms == 2
        else f", and {counting} the photons that each lets through."
    )
    if _is_adaptive(payload):
        words += (
            " Each next mask is made from all counts so far: of those that separate the likeliest "
            "classes, the one of which the counts are expected to tell most of the class."
        )
    if looks:
        words += (
            f" It goes through its masks {looks} times, and each time it chooses from the counts "
            "so far for how long to show each mask."
        )
    return words


def facts_of(payload: Payload) -> list[tuple[str, str]]:
    """Name and words of what is to be known about a design."""
    test = payload["test"]
    facts = {
        "Camera": way_text(payload),
        "Data": f"{payload['data']['name']}. {payload['data']['preprocessing']}",
        "Detectors": f"{detectors_text(payload)}.",
        "Light law": f"{payload['light']}: {LAWS[payload['light']]}.",
        **(_posterior(payload) if _is_adaptive(payload) else _networks(payload)),
        "Stopping": _stopping(payload),
        "Accuracy": f"Share of {test['images']} test scenes that are classified rightly, with "
        f"{test['draws']} noise draw{'s' if test['draws'] > 1 else ''} of each. The bars are 95 % "
        f"intervals over {test['covers']}. Circles are measured; the line joins them.",
    }
    return [(name, words) for name, words in facts.items() if words]


def _networks(payload: Payload) -> dict[str, str]:
    """Facts on masks that are known before, and their network."""
    budget, exposure = payload["budget"], payload["exposure"]
    ends = dict.fromkeys(photons_text(budget[end]) for end in ("low", "high")) if budget else ()
    hidden = [str(layer["weight"]["shape"][0]) for layer in payload["network"][:-1]]
    return {
        "Masks": f"{masks_text(payload)}. {RAILS[payload['rails']]}",
        "Learned for": f"{' to '.join(ends)} photons." if ends else "",
        "Noise": _noise(payload["dark"]),
        "Network": f"Fully connected, hidden layers of {' and '.join(hidden) or 'no'} units.",
        "Nested": f"The first {exposure['nested']} masks are enough for an answer."
        if exposure.get("nested")
        else "",
        "Probabilities": _calibrated(payload),
    }


def _posterior(payload: Payload) -> dict[str, str]:
    """Facts on adaptive masks, and the scenes that the page knows."""
    scenes, of = payload["known"]["scenes"], payload["known"]["of"]
    kind = f"{'centres of clusters of ' * payload['known']['centres']}training scenes of the design"
    even = len(set(payload["shares"])) == 1
    return {
        "Masks": f"{masks_text(payload)}, each shown for {'the same' if even else 'its own'} share "
        "of the exposure. Mirrors are ON or OFF.",
        "Noise": _noise(payload["dark"]),
        "Prior": f"This page knows {scenes} of the {of} {kind}, of each "
        "class the same share, and the accuracy above is of these. All of them may tell more."
        if scenes < of
        else f"This page knows the {of} {kind}.",
        "Probabilities": "The posterior of the class. No network is trained, and nothing is "
        "calibrated.",
    }


def _noise(dark: float) -> str:
    """Words for the counts, with so many dark counts of a detector in an exposure."""
    if not dark:
        return "Exact Poisson counts. There are no dark counts, no dead time and no stray light."
    return (
        f"Exact Poisson counts, with {dark:.3g} dark counts of each detector in a whole exposure, "
        "whatever the light. There is no dead time and no stray light."
    )


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
