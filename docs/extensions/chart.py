"""A chart of a table, drawn while the site is built.

The argument of the directive `chart` is the label of a table of its page, `(label)=` above it;
without an argument the table is the content. Where the heads or the first column are numbers, they
are the axis and the others are lines; else each row is a group of bars. `show` names what to draw.
"""

import math
import re
from html import escape
from pathlib import Path
from typing import ClassVar

import matplotlib
from docutils.parsers.rst.directives import flag, unchanged, unchanged_required
from markdown import Made
from matplotlib.figure import Figure
from measured import filled

from deepfsi.report import style

RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹−", "0123456789-")
NUMBER = re.compile(r"\W*?([+−-]?\d+(?: \d{3})*(?:\.\d+)?(?:e\d+)?)( [·×] 10)?([⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")
INTERVAL = re.compile(r"(?:± ?(\d\.\d+)|\[(\S+), (\S+)\])")
DESIGNS = {
    "truncated-hadamard": "truncated hadamard|th",
    "hadamard": "hadamard|hb",
    "raster": "raster scan|rs",
    "impulse": "impulse imaging|ii",
    "pca": "pca|fsi",
    "control": "control group|cg",
    "adaptive": "adaptive masks",
    "lda": "linear discriminants|lda",
    "random": "random|rnd",
    "custom": r"\d+ looks",
    "s-matrix": "s-matrix",
    "deepfsi": "deepfsi|dfsi|ovit|learned|fixed dwells",
}
SECOND = ("custom", "class-pairs")
FEW_ROWS = 3
"""Rows of a legend for which a chart has room."""
OTHERS = ("pca", "deepfsi", "truncated-hadamard", "hadamard", "control", "lda", "random", "custom")


def number(text, whole=False):
    """Number that a text begins with, `whole` if a unit may follow and no more; else NaN."""
    found = NUMBER.match(text)
    if not found or (whole and not re.fullmatch(r"\**( (photons|s|ns))?", text[found.end() :])):
        return math.nan
    value = float(found[1].replace(" ", "").translate(RAISED))
    power = float((found[3] or "1").translate(RAISED))
    return value * 10**power if found[2] else value**power


def reach(text):
    """Value of a cell, and how far its interval reaches below and above it."""
    value, found = number(text), INTERVAL.search(text)
    if not found:
        return value, 0.0, 0.0
    if found[1]:
        return value, float(found[1]), float(found[1])
    return value, value - number(found[2]), number(found[3]) - value


def read(lines):
    """Cells of the first table in lines of Markdown: its heads, and its rows."""
    first = next((place for place, line in enumerate(lines) if line.startswith("|")), len(lines))
    rows = []
    for line in lines[first:]:
        if not line.startswith("|"):
            break
        rows.append([cell.strip().strip("*") for cell in line.strip("| \n").split("|")])
    if len(rows) < 3:
        raise ValueError("no table stands there")
    return rows[0], [row + [""] * (len(rows[0]) - len(row)) for row in rows[2:]]


def chosen(heads, rows, show):
    """Places on the axis, words where it has no numbers, and the cells of each line by its name."""
    if not math.isnan(sum(number(head, whole=True) for head in heads[1:])):
        places, lines = [number(head) for head in heads[1:]], {row[0]: row[1:] for row in rows}
    else:
        places = [number(row[0], whole=True) for row in rows]
        places = [row[0] for row in rows] if math.isnan(sum(places)) else places
        lines = {head: [row[k] for row in rows] for k, head in enumerate(heads) if k}
    for name in show or lines:
        if name not in lines:
            raise ValueError(f"the table has no {name!r}, it has {', '.join(lines)}")
        if all(math.isnan(number(cell)) for cell in lines[name]):
            raise ValueError(f"{name!r} has no numbers")
    return places, {name: lines[name] for name in show or lines}


def looks(names):
    """Design whose colour and line each name has: its own, or one that no other name has."""
    owned = {
        name: [key for key, words in DESIGNS.items() if re.search(rf"\b({words})\b", name.lower())]
        for name in names
    }
    taken = {}
    for name in sorted(names, key=lambda name: not owned[name]):
        own = owned[name]
        free = (*own, *(SECOND if own else ()), *OTHERS)
        taken[name] = next((key for key in free if key not in taken.values()), "raster")
    return [taken[name] for name in names]


def drawn(places, lines, x, y, scale="linear"):
    """Figure of lines with their intervals, or of bars."""
    bars = isinstance(places[0], str)
    columns = style.columns(lines, 4.4, style.STYLE["font.size"])
    under = 0.18 * max(0, -(-len(lines) // columns) - FEW_ROWS)
    tall = 0.8 + 0.24 * len(places) * max(len(lines), 1.3) if bars else 3.1 + under
    figure = Figure((4.5, tall), layout="constrained")
    ax = figure.subplots()
    for place, (name, key) in enumerate(zip(lines, looks(lines), strict=True)):
        values, *spread = zip(*map(reach, lines[name]), strict=True)
        look = {"color": style.DESIGN_COLOURS[key], "label": name}
        if bars:
            wide = 0.8 / len(lines)
            at = [row + wide * (place - (len(lines) - 1) / 2) for row in range(len(places))]
            if len(lines) == 1:
                look["color"] = [style.DESIGN_COLOURS[looks([own])[0]] for own in places]
            ax.barh(at, values, wide, xerr=spread, error_kw={"elinewidth": 0.9}, **look)
        else:
            look |= {"ls": style.DESIGN_LINES[key], "marker": "o", "ms": 3.5}
            least = 0 if scale == "log" else -math.inf  # a logarithmic axis has no place for 0
            kept = [k for k, value in enumerate(values) if value > least]
            part = [[each[k] for k in kept] for each in (places, values, *spread)]
            ax.errorbar(*part[:2], yerr=part[2:], elinewidth=0.9, capsize=2, **look)
    if bars:
        ax.set_yticks(range(len(places)), places)
        ax.invert_yaxis()
        ax.set_xlabel(y)
    else:
        scaled(ax, [at for at in places if any(at in line.get_xdata() for line in ax.lines)])
        ax.set(xlabel=x, ylabel=y, yscale=scale)
        ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        ax.minorticks_off()
    ax.grid(axis="x" if bars else "both")
    if len(lines) > 1:
        figure.legend(loc="outside lower center", ncols=columns, frameon=False)
    return figure


def scaled(ax, places):
    """Ticks at the places, every other one of many; logarithmic where they span more than 20."""
    if min(places) > 0 and max(places) / min(places) > 20:
        ax.set_xscale("log")
    ticks = places[:: 1 + len(places) // 9]
    ax.set_xticks(ticks, [style.photons_text(tick) for tick in ticks])


class Chart(Made):
    """The directive."""

    optional_arguments = 1
    option_spec: ClassVar = {
        "alt": unchanged_required,
        "show": unchanged,
        "x": unchanged,
        "y": unchanged,
        "log": flag,
    }

    def text(self):
        """An image, and a link to its numbers."""
        label, lines = "".join(self.arguments), list(self.content)
        if label:
            page = filled(Path(self.env.doc2path(self.env.docname)).read_text()).splitlines()
            lines = page[page.index(f"({label})=") if f"({label})=" in page else len(page) :]
        show = [name.strip() for name in self.options.get("show", "").split(";") if name.strip()]
        try:
            if not self.options.get("alt"):
                raise ValueError("it needs the option alt, what one sees in words")
            places, found = chosen(*read(lines), show)
        except ValueError as fault:
            raise self.error(f"chart {label}: {fault}") from None
        return self.image(places, found, label)

    def image(self, places, lines, label):
        """Markdown of the image that is drawn into the site."""
        x, y = self.options.get("x", style.BUDGET_AXIS), self.options.get("y", style.ACCURACY_AXIS)
        name = f"{self.env.docname.replace('/', '-')}-{label or self.lineno}.svg"
        path = Path(self.env.app.outdir) / "charts" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with matplotlib.rc_context({**style.STYLE, "font.family": "sans-serif"}):
            figure = drawn(places, lines, x, y, "log" if "log" in self.options else "linear")
            figure.savefig(path, facecolor="white", metadata={"Date": None})
        address = "../" * self.env.docname.count("/") + f"charts/{name}"
        image = f'<img class="chart" src="{address}" alt="{escape(self.options["alt"])}">'
        numbers = f"\n\n*The numbers are in [the table](#{label}).*" if label else ""
        return f"```{{raw}} html\n{image}\n```{numbers}"


def setup(app):
    """Add the directive."""
    app.add_directive("chart", Chart)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
