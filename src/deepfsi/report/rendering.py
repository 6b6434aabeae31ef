"""Templates and colours of every page, and settings written as name and value."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from deepfsi.camera import noise_text
from deepfsi.report.style import COLOURS, DARK_COLOURS, photons_text
from deepfsi.report.terms import LAWS, WORDS, Terms

HERE = Path(__file__).parent


def render(template: str, folder: Path = HERE, /, **values: Any) -> str:
    """Text of a page: a template of this folder or another, filled in; every value is escaped."""
    environment = Environment(
        loader=FileSystemLoader([folder, HERE]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    terms = Terms()
    environment.filters.update(
        photons=photons_text,
        counts=counts_text,
        noise=noise_text,
        share=share_text,
        explain=terms.explain,
        noted=terms.noted,
    )
    return environment.get_template(template).render(
        colours=COLOURS, dark_colours=DARK_COLOURS, terms=terms, field=WORDS, laws=LAWS, **values
    )


def capital(words: str) -> str:
    """Words with a capital first letter."""
    return words[:1].upper() + words[1:]


def share_text(value: float | None) -> str:
    """Write a share between 0 and 1 with three decimals; a dash where there is none."""
    return "–" if value is None else f"{value:.3f}"


def counts_text(counts: float | None) -> str:
    """Write a mean number of counts with three digits; a dash where it is not known."""
    return "–" if counts is None else photons_text(float(f"{counts:.3g}"))


def flat(tree: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    """Yield settings that are set as name and value, nested names joined with a dot."""
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{above}{name}.")
        else:
            items = value if isinstance(value, list | tuple) else [value]
            if words := ", ".join(_setting(each) for each in items if each not in (None, "")):
                yield above + name, words


def _setting(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
