"""Pages are plain Markdown in the repository; Sphinx reads them with what only the site has.

- Links to files outside `docs/` and to scripts lead to their pages on the site.
- ``Fields: [….Camera](…)`` and ``Modules: [physics](…)`` become what is made of them.
- Lines that begin with ``Source:`` are left out.
- Directives stand in comments: ``<!-- index ! resume -->``.
- A page that is one link to a file at the root of the repository becomes this file.
"""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
WHOLE = re.compile(r"\[\w+\]\(\.\./\.\./(\w+\.md)\)\n")
SOURCE = re.compile(r"^Source: .*\n", re.M)
MADE = re.compile(r"^(Fields|Modules): (.+)$", re.M)
NAMES = "commands|devices|eval-rst|index|overview|playable|toctree"
HIDDEN = re.compile(rf"^<!-- ({NAMES})\b ?(.*?)\s*-->$", re.M | re.S)
HOMES = (
    (r"(?:\.\./)*CHANGELOG\.md", lambda path: "/lookup/changelog.md"),
    (
        r"(?:\.\./)*(?:CONTRIBUTING|RELEASING|SECURITY)\.md",
        lambda path: f"/develop/{path.split('/')[-1].lower()}",
    ),
    (
        r"(?:\.\./)*(?:gallery/\w+|tutorial)/plot_\w+\.py",
        lambda path: f"/generated/{path.replace('../', '')[:-3]}.rst",
    ),
    (
        r"(?:\.\./)*(?:gallery|tutorial)",
        lambda path: f"/generated/{path.replace('../', '')}/index.rst",
    ),
)


def turned(text):
    """Text of a Markdown page as the site reads it."""
    for there, home in HOMES:
        text = re.sub(rf"(?<=\]\(){there}(?=[#)])", lambda link, home=home: home(link[0]), text)
    text = MADE.sub(lambda line: f"```{{{line[1].lower()}}} {words(line[2])}\n```", text)
    return HIDDEN.sub(r"```{\1} \2\n```", SOURCE.sub("", text))


def words(line):
    """Words of the links of a line."""
    return " ".join(re.findall(r"\[(.+?)\]", line))


def whole(name):
    """Text of a file at the root of the repository, its links as in a page of the site.

    A link whose words are the path of a page gets the title of the page.
    """
    text = (ROOT / name).read_text().replace("](docs/", "](/")
    return re.sub(r"\[docs/[\w/-]+\.md\](?=\(/)", "[]", text)


def turn(app, page, source):
    """Turn a page that Sphinx reads."""
    link = WHOLE.fullmatch(source[0])
    source[0] = turned(whole(link[1]) if link else source[0])


def setup(app):
    """Turn pages as they are read."""
    app.connect("source-read", turn)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
