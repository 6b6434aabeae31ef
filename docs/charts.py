"""Charts of the pages, drawn from the tables that stand in them: ``python docs/charts.py``.

The comment ``<!-- chart mnist -->`` before a table of a page makes `docs/figures/chart-mnist.svg`.
Where the heads or the first column are numbers, they are the axis and the others are lines; else
each row is a group of bars. Behind the name may stand settings in TOML: `show` (the lines that are
drawn), `x`, `y` (words of the axes) and `log = true`.
"""

import json
import math
import re
import tomllib
from io import StringIO
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from deepfsi.report import style

DOCS = Path(__file__).parent
MARKED = re.compile(r"^<!-- chart ([\w-]+)(.*?)-->\n+((?:\|[^\n]*\n)+)", re.M | re.S)
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


def marked(text):
    """Charts of a page: name, settings, heads and rows of the table."""
    for name, settings, table in MARKED.findall(text):
        lines = [line.strip("| ").split("|") for line in table.splitlines()]
        heads, _, *rows = ([cell.strip(" *") for cell in line] for line in lines)
        rows = [row + [""] * (len(heads) - len(row)) for row in rows]
        yield name, tomllib.loads(settings), heads, rows


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


def drawn(places, lines, x, y, log=False):
    """Figure of lines with their intervals, or of bars."""
    bars = isinstance(places[0], str)
    widest = max(map(len, lines))
    columns = max(1, int(4.4 / (0.5 + 0.072 * widest)))  # of a key that fits, in inches
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
            least = 0 if log else -math.inf  # a logarithmic axis has no place for 0
            kept = [k for k, value in enumerate(values) if value > least]
            part = [[each[k] for k in kept] for each in (places, values, *spread)]
            ax.errorbar(*part[:2], yerr=part[2:], elinewidth=0.9, capsize=2, **look)
    if bars:
        ax.set_yticks(range(len(places)), places)
        ax.invert_yaxis()
        ax.set_xlabel(y)
    else:
        scaled(ax, [at for at in places if any(at in line.get_xdata() for line in ax.lines)])
        ax.set(xlabel=x, ylabel=y, yscale="log" if log else "linear")
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


def charts():
    """What each chart shows, by its name: places, lines, and words of the axes."""
    found = {}
    for page in [DOCS / "index.md", *sorted(DOCS.glob("[!_g]*/*.md"))]:
        for name, settings, heads, rows in marked(page.read_text()):
            if name in found:
                raise ValueError(f"two charts have the name {name}")
            places, lines = chosen(heads, rows, settings.pop("show", None))
            words = {"x": style.BUDGET_AXIS, "y": style.ACCURACY_AXIS, **settings}
            found[name] = {"places": places, "lines": lines, **words}
    return found


def main():
    """Draw all; each file says in its description what it shows."""
    for path in (DOCS / "figures").glob("chart-*.svg"):
        path.unlink()
    with matplotlib.rc_context(
        {**style.STYLE, "font.family": "sans-serif", "svg.fonttype": "none"}
    ):
        for name, chart in charts().items():
            told = {"Date": None, "Creator": None}
            told["Description"] = json.dumps(chart, ensure_ascii=False)
            file = StringIO()
            drawn(**chart).savefig(file, format="svg", facecolor="white", metadata=told)
            text = " ".join(file.getvalue().split())
            (DOCS / f"figures/chart-{name}.svg").write_text(f"{text}\n")


if __name__ == "__main__":
    main()
