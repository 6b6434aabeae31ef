"""One HTML file of a design's payload and the scripts that play it, without a request."""

import os
import re
from math import prod
from pathlib import Path

from markupsafe import Markup

from deepfsi.base import write_atomically
from deepfsi.camera import LIGHT_LAWS
from deepfsi.report.playground.words import Payload, detectors_text, facts_of, lead_text, masks_text
from deepfsi.report.rendering import render

SCRIPTS = tuple(
    f"{name}.js"
    for name in (
        "page", "numbers", "model", "exposure", "posterior", "choice", "looks", "scene", "charts",
        "known", "adaptive", "app",
    )
)  # fmt: skip
"""Modules of the page, each after those that it imports."""


def write_page(path: str | os.PathLike[str], payload: Payload) -> Path:
    """Write the page of a design, whole or not at all."""
    page = render(
        "playground/page.html.jinja",
        payload=payload,
        law=LIGHT_LAWS[payload["light"]],
        script=Markup(bundle()),
        title=f"A class from few photons: {payload['data']['name']} through {masks_text(payload)}",
        lead=lead_text(payload),
        facts=facts_of(payload),
        pixels=prod(payload["image_shape"]),
        detectors=detectors_text(payload),
        bands=_bands(payload),
    )
    return write_atomically(path, page.encode())


def _bands(payload: Payload) -> tuple[int, int] | None:
    """Shortest and longest wavelength of a spectrum, nm, where its bands are known."""
    known = [each for each in payload["scenes"]["wavelengths"] or [] if each > 0]
    return (round(min(known)), round(max(known))) if known else None


def bundle() -> str:
    """The page's modules as one: without their imports of each other, and their exports."""
    folder = Path(__file__).parent
    every = "\n".join((folder / name).read_text(encoding="utf-8") for name in SCRIPTS)
    alone = re.sub(r"^import [^;]*;\n", "", every, flags=re.MULTILINE)
    return re.sub(r"^export ", "", alone, flags=re.MULTILINE)
