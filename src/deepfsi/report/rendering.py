"""Templates of every page, with the terms that they explain."""

import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.report.style import DARK_COLOURS, DESIGN_COLOURS, photons_text

_TEMPLATES = Path(__file__).parent


def render(template: str, folder: Path = _TEMPLATES, /, **values: Any) -> str:
    """Text of a page."""
    environment = Environment(
        loader=FileSystemLoader([folder, _TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        photons=photons_text,
        counts=lambda counts: "–" if counts is None else photons_text(float(f"{counts:.3g}")),
        capital=capital,
        share=share_text,
    )
    return environment.get_template(template).render(
        colours=DESIGN_COLOURS,
        dark_colours=DARK_COLOURS,
        laws={name: law.optics for name, law in LIGHT_LAWS.items()},
        **tomllib.loads(files(__package__).joinpath("terms.toml").read_text("utf-8")),
        **values,
    )


def capital(words: str) -> str:
    """Words with a capital first letter."""
    return words[:1].upper() + words[1:]


def share_text(value: float | None) -> str:
    """Write a share between 0 and 1 with three decimals; a dash for None."""
    return "–" if value is None else f"{value:.3f}"
