"""Words of the field and abbreviations that the pages use, each with what it means."""

import re
import tomllib
from importlib.resources import files

from markupsafe import Markup, escape

from deepfsi.camera import LIGHT_LAWS

_TERMS = tomllib.loads(files(__package__).joinpath("terms.toml").read_text("utf-8"))

DESIGNS: dict[str, str] = _TERMS["designs"]
"""What each design is."""

LAWS: dict[str, str] = {name: law.words for name, law in LIGHT_LAWS.items()}
"""What each light law allows, and with which optics."""

WORDS: dict[str, str] = _TERMS["words"]
"""Words of the field."""

ABBREVIATIONS: dict[str, str] = {
    name: words.format_map(DESIGNS) for name, words in _TERMS["abbreviations"].items()
}
"""Abbreviations in words and figures of the pages."""

_KNOWN = re.compile(rf"(?<![\w&-])({'|'.join(ABBREVIATIONS)})(?![\w])")


class Terms:
    """Abbreviations of one page, explained where they stand and listed at its end."""

    def __init__(self) -> None:
        self._used: set[str] = set()
        self._linked: set[str] = set()

    @property
    def used(self) -> dict[str, str]:
        """Abbreviations so far, with what they mean."""
        return {name: words for name, words in ABBREVIATIONS.items() if name in self._used}

    def explain(self, text: object) -> Markup:
        """Text with its abbreviations marked; the first of each in words leads to the list."""
        return Markup(_KNOWN.sub(lambda found: self._marked(found[0]), str(escape(text))))

    def noted(self, drawn: Markup) -> Markup:
        """A figure as it is, the abbreviations of its words to be listed."""
        for text in re.findall(r"<text[^>]*>([^<]*)<", drawn):
            self._used.update(_KNOWN.findall(text))
        return drawn

    def _marked(self, name: str) -> str:
        marked = f'<abbr title="{escape(ABBREVIATIONS[name])}">{name}</abbr>'
        self._used.add(name)
        if name in self._linked:
            return marked
        self._linked.add(name)
        return f'<a class="term" href="#term-{name}">{marked}</a>'


def lit_text(masks: int, lit: float) -> str:
    """Number of masks asked and lit: 24 asked, 16 lit: 8 have no time under this budget."""
    dark = masks - lit
    have = "has" if dark == 1 else "have"
    return f"{masks} asked, {lit:.3g} lit: {dark:.3g} {have} no time under this budget"
