"""One HTML file of a design and the scripts that play it, without a request."""

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from deepfsi.base.files import write_atomically
from deepfsi.base.quantities import plural
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.report.rendering import render

_SCRIPTS = tuple(
    f"{name}.js"
    for name in (
        "page", "numbers", "model", "exposure", "posterior", "choice", "looks", "scene", "charts",
        "known", "adaptive", "app",
    )
)  # fmt: skip
"""Modules of the page, each after those that it imports."""


def write_page(path: str | os.PathLike[str], payload: Mapping[str, Any]) -> Path:
    """Write the page of a design, as `playable` makes it, whole or not at all."""
    adaptive = "prior" in payload
    masks = len(payload["shares"]) if adaptive else payload["matrix"]["shape"][0]
    page = render(
        "playground/page.html.jinja",
        payload=payload,
        law=LIGHT_LAWS[payload["light"]],
        script=Markup(_bundle()),
        masks=plural(masks, "adaptive mask" if adaptive else "mask"),
    )
    return write_atomically(path, page.encode())


def _bundle() -> str:
    """The page's modules as one: without their imports of each other, and their exports."""
    folder = Path(__file__).parent / "playground"
    script = "\n".join((folder / name).read_text(encoding="utf-8") for name in _SCRIPTS)
    script = re.sub(r"^import [^;]*;\n", "", script, flags=re.MULTILINE)
    return re.sub(r"^export ", "", script, flags=re.MULTILINE)
