"""Links that work in the repository and on the site.

Pages link to files outside `docs/` and to gallery scripts as they lie in the repository. The site
has pages of these, to which the links are turned when a page is read.
"""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
WHOLE = re.compile(r"```\{include\} \.\./\.\./(\w+\.md)\n```")
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
)


def turned(text):
    """Text of a Markdown page with its links turned to pages of the site."""
    for there, home in HOMES:
        text = re.sub(rf"(?<=\]\(){there}(?=[#)])", lambda link, home=home: home(link[0]), text)
    return text


def whole(name):
    """Text of a file at the root of the repository, its links as in a page of the site.

    A link whose words are the path of a page gets the title of the page.
    """
    text = (ROOT / name).read_text().replace("](docs/", "](/")
    return re.sub(r"\[docs/[\w/-]+\.md\](?=\(/)", "[]", text)


def turn(app, page, source):
    """Turn the links of a page that Sphinx reads."""
    source[0] = turned(WHOLE.sub(lambda found: whole(found[1]), source[0]))


def setup(app):
    """Turn links as pages are read."""
    app.connect("source-read", turn)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
