"""One HTML file of a design and the scripts that play it, without a request."""

import os
import re
from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import Any

from markupsafe import Markup

from deepfsi.base.files import write_atomically
from deepfsi.base.quantities import plural
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.report.rendering import LAW_TERMS, render
from deepfsi.report.style import photons_text

_Payload = Mapping[str, Any]
"""A design as the page needs it, as `playable` makes it."""

_SCRIPTS = tuple(
    f"{name}.js"
    for name in (
        "page", "numbers", "model", "exposure", "posterior", "choice", "looks", "scene", "charts",
        "known", "adaptive", "app",
    )
)  # fmt: skip
"""Modules of the page, each after those that it imports."""

_RAILS_WORDS = {
    1: "Non-negative: each mask has one rail, and the network does any subtraction.",
    2: "Signed: each mask has a positive and a negative rail, which are counted separately.",
}
"""Words for masks of so many rails."""


def write_page(path: str | os.PathLike[str], payload: Mapping[str, Any]) -> Path:
    """Write the page of a design, whole or not at all."""
    bands = [nm for nm in payload["scenes"]["wavelengths"] or [] if nm > 0]
    masks = _masks_text(payload)
    how = "counts photons through masks, and a small network reads the counts"
    if _is_adaptive(payload):
        how = "counts photons through masks, each made from all counts so far"
    page = render(
        "playground/page.html.jinja",
        payload=payload,
        law=LIGHT_LAWS[payload["light"]],
        script=Markup(_bundle()),
        title=f"A class from few photons: {payload['data']['name']} through {masks}",
        lead=f"This camera takes no picture: it {how}. Set a scene and its light, and press "
        "Expose.",
        facts=_facts(payload),
        pixels=prod(payload["image_shape"]),
        detectors=_detector_count_text(payload),
        bands=(round(min(bands)), round(max(bands))) if bands else None,
    )
    return write_atomically(path, page.encode())


def _bundle() -> str:
    """The page's modules as one: without their imports of each other, and their exports."""
    folder = Path(__file__).parent
    every = "\n".join((folder / name).read_text(encoding="utf-8") for name in _SCRIPTS)
    alone = re.sub(r"^import [^;]*;\n", "", every, flags=re.MULTILINE)
    return re.sub(r"^export ", "", alone, flags=re.MULTILINE)


def _is_adaptive(payload: _Payload) -> bool:
    """True of a page of adaptive masks."""
    return "prior" in payload


def _masks(payload: _Payload) -> int:
    return len(payload["shares"]) if _is_adaptive(payload) else payload["matrix"]["shape"][0]


def _masks_text(payload: _Payload) -> str:
    """Number of masks."""
    return plural(_masks(payload), "adaptive mask" if _is_adaptive(payload) else "mask")


def _detector_count_text(payload: _Payload) -> str:
    """Number of detectors, and which light each of them has."""
    # Where the light is divided, what is divided is counted at the same time
    law = LIGHT_LAWS[payload["light"]]
    parts = payload["detectors"]
    if not law.in_turn:
        count = payload["rails"] * _masks(payload)
        words = [f"one for {_readout(payload)}"]
    else:
        count = law.arms
        words = ["one on each arm"] if law.arms == 2 else []
    words += ["each on its part of the scene"] if parts > 1 else []
    return ", ".join([str(parts * count), *words])


def _readout(payload: _Payload) -> str:
    return "each rail of each mask" if payload["rails"] == 2 else "each mask"


def _way_text(payload: _Payload) -> str:
    """Sentences on the way in which the camera counts."""
    law = LIGHT_LAWS[payload["light"]]
    if law.in_turn and not law.one_device:
        return f"{law.words.capitalize()}."
    if not law.in_turn:
        return (
            f"Its optics split the light of each pixel among {_masks_text(payload)} at once, with "
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
    return words


def _facts(payload: _Payload) -> list[tuple[str, str]]:
    """Name and words of what is to be known about a design."""
    test = payload["test"]
    facts = {
        "Camera": _way_text(payload),
        "Data": f"{payload['data']['name']}. {payload['data']['preprocessing']}",
        "Detectors": f"{_detector_count_text(payload)}.",
        "Light law": f"{payload['light']}: {LAW_TERMS[payload['light']]}.",
        **(_posterior(payload) if _is_adaptive(payload) else _networks(payload)),
        "Stopping": _stopping(payload),
        "Accuracy": f"Share of {test['images']} test scenes that are classified rightly, with "
        f"{plural(test['draws'], 'noise draw')} of each. The bars are 95 % "
        f"intervals over {test['covers']}. Circles are measured; the line joins them.",
    }
    return [(name, words) for name, words in facts.items() if words]


def _networks(payload: _Payload) -> dict[str, str]:
    """Facts on masks that are known before, and their network."""
    budget = payload["budget"]
    ends = dict.fromkeys(photons_text(budget[end]) for end in ("low", "high")) if budget else ()
    hidden = [str(layer["weight"]["shape"][0]) for layer in payload["network"][:-1]]
    return {
        "Masks": f"{_masks_text(payload)}. {_RAILS_WORDS[payload['rails']]}",
        "Learned for": f"{' to '.join(ends)} photons." if ends else "",
        "Noise": _noise(payload["dark"]),
        "Network": f"Fully connected, hidden layers of {' and '.join(hidden) or 'no'} units.",
        "Probabilities": _calibrated(payload),
    }


def _posterior(payload: _Payload) -> dict[str, str]:
    """Facts on adaptive masks, and the scenes that the page knows."""
    prior = payload["known"]
    kind = f"{'centres of clusters of ' * prior['centres']}training scenes of the design"
    even = len(set(payload["shares"])) == 1
    return {
        "Masks": f"{_masks_text(payload)}, each shown for {'the same' if even else 'its own'} "
        "share of the exposure. Mirrors are ON or OFF.",
        "Noise": _noise(payload["dark"]),
        "Prior": f"This page knows {prior['scenes']} of the {prior['of']} {kind}, of each "
        "class the same share, and the accuracy above is of these. All of them may tell more."
        if prior["scenes"] < prior["of"]
        else f"This page knows the {prior['of']} {kind}.",
        "Probabilities": "The posterior of the class, calibrated with training scenes that it is "
        "left without. No network is trained.",
    }


def _noise(dark: float) -> str:
    """Words for the counts, with so many dark counts of a detector in an exposure."""
    if not dark:
        return "Exact Poisson counts. There are no dark counts, no dead time and no stray light."
    return (
        f"Exact Poisson counts, with {dark:.3g} dark counts of each detector in a whole exposure, "
        "whatever the light. There is no dead time and no stray light."
    )


def _calibrated(payload: _Payload) -> str:
    """Words for the light at which probabilities say how often an answer is right."""
    temperatures = payload["temperatures"]
    if temperatures is None:
        return "Not calibrated: the network may be surer than it is right."
    least = photons_text(temperatures["dimmest"])
    return (
        "Calibrated at each light, so that they say how often such an answer is right for scenes "
        f"like those of the training. Below {least} photons there is too little light for this "
        "design."
    )


def _stopping(payload: _Payload) -> str:
    """Words for the rule by which an exposure stops, if there is one."""
    if not payload["rules"]:
        return "This design has no rule for stopping early."
    return (
        "An exposure ends as soon as the probability of one class is above a threshold, found with "
        "training scenes so that they take the budget in the mean. It holds near that budget."
    )
