"""Templates of every page: their filters, tables, terms and abbreviations with what they mean."""

import html
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from deepfsi.base.numeric.intervals import MOST_CLASSES, confusion_shares, frequent_confusions
from deepfsi.camera.names import LIGHT_LAWS, noise_text
from deepfsi.report.style import DARK_COLOURS, DESIGN_COLOURS, photons_text

_TEMPLATES = Path(__file__).parent

_TERMS = tomllib.loads(files(__package__).joinpath("terms.toml").read_text("utf-8"))

TINT = "0, 114, 178"
"""Red, green and blue of the cells of a confusion matrix."""

DESIGN_TERMS: dict[str, str] = _TERMS["designs"]
"""What each design is."""

LAW_TERMS: dict[str, str] = {name: law.words for name, law in LIGHT_LAWS.items()}
"""What each light law allows, and with which optics."""

ABBREVIATIONS: dict[str, str] = {
    name: words.format_map(DESIGN_TERMS) for name, words in _TERMS["abbreviations"].items()
}
"""Abbreviations in words and figures of the pages."""

_ABBREVIATION = re.compile(rf"(?<![\w&-])({'|'.join(ABBREVIATIONS)})(?![\w])")


def render(template: str, folder: Path = _TEMPLATES, /, **values: Any) -> str:
    """Text of a page."""
    environment = Environment(
        loader=FileSystemLoader([folder, _TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    terms = _Terms()
    environment.filters.update(
        photons=photons_text,
        counts=lambda counts: "–" if counts is None else photons_text(float(f"{counts:.3g}")),
        capital=capital,
        noise=noise_text,
        share=share_text,
        explain=terms.explain,
        noted=terms.noted,
    )
    return environment.get_template(template).render(
        colours=DESIGN_COLOURS,
        dark_colours=DARK_COLOURS,
        terms=terms,
        field=_TERMS["words"],
        laws=LAW_TERMS,
        **values,
    )


class _Terms:
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
        return Markup(_ABBREVIATION.sub(lambda match: self._marked(match[0]), str(escape(text))))

    def noted(self, drawn: Markup) -> Markup:
        """A figure as it is, the abbreviations of its words to be listed."""
        for text in re.findall(r"<text[^>]*>([^<]*)<", drawn):
            self._used.update(_ABBREVIATION.findall(text))
        return drawn

    def _marked(self, name: str) -> str:
        marked = f'<abbr title="{escape(ABBREVIATIONS[name])}">{name}</abbr>'
        self._used.add(name)
        if name in self._linked:
            return marked
        self._linked.add(name)
        return f'<a class="term" href="#term-{name}">{marked}</a>'


def capital(words: str) -> str:
    """Words with a capital first letter."""
    return words[:1].upper() + words[1:]


def share_text(value: float | None) -> str:
    """Write a share between 0 and 1 with three decimals; a dash where there is none."""
    return "–" if value is None else f"{value:.3f}"


def english_list(words: list[str]) -> str:
    """Words as an English list."""
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def flat(tree: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    """Yield settings that are set as name and value, nested names joined with a dot."""
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{above}{name}.")
        else:
            items = value if isinstance(value, list | tuple) else [value]
            if words := ", ".join(_setting(item) for item in items if item not in (None, "")):
                yield above + name, words


def _setting(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def confusion_table(confusion: Sequence[Sequence[int]], classes: Sequence[str]) -> str:
    """Table of the shares of answers (C, C) for each true class; of many, of frequent mistakes."""
    names = [html.escape(name) for name in classes]
    if len(names) > MOST_CLASSES:
        rows = [
            f"<tr><th scope='row'>{names[i]}</th><td>{names[j]}</td><td>{share:.1%}</td></tr>"
            for i, j, share in frequent_confusions(confusion)
        ]
        heads = "".join(f"<th scope='col'>{head}</th>" for head in ("true", "answered", "share"))
        return f"<table><thead><tr>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    heads = "".join(f"<th scope='col'>{name}</th>" for name in names)
    rows = []
    for name, row in zip(names, confusion_shares(confusion), strict=True):
        cells = "".join(
            f"<td style='background: rgba({TINT}, {0.6 * share:.3f})'>{_percent(share)}</td>"
            for share in row
        )
        rows.append(f"<tr><th scope='row'>{name}</th>{cells}</tr>")
    head = f"<tr><th scope='col'>true \\ answered, %</th>{heads}</tr>"
    return f"<table class='confusion'><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table>"


def _percent(share: float) -> str:
    """Share in per cent; nothing for none, so that mistakes stand out."""
    return "" if share == 0 else "100" if share == 1 else f"{100 * share:.1f}"
