"""Rendering of all pages from templates, with the terms that they explain."""

import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.report.style import DESIGN_COLOURS, photons_text

_TEMPLATES = Path(__file__).parent


def render(template: str, folder: Path = _TEMPLATES, /, **values: Any) -> str:
    """Text of a page."""
    environment = Environment(
        loader=FileSystemLoader([folder, _TEMPLATES]),
        # Names of classes and data sets may hold HTML
        autoescape=True,
        # A name that is missing is an error, not an empty text
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        photons=photons_text,
        capital=capital,
        share="{:.3f}".format,
    )
    return environment.get_template(template).render(
        colours=DESIGN_COLOURS,
        laws={name: law.optics for name, law in LIGHT_LAWS.items()},
        **tomllib.loads(files(__package__).joinpath("terms.toml").read_text("utf-8")),
        **values,
    )


def capital(words: str) -> str:
    """Words with a capital first letter."""
    return words[:1].upper() + words[1:]
