"""Links that work in the repository and on the site.

Pages link to files outside `docs/` and to gallery scripts as they lie in the repository. The site
has pages of these, to which the links are turned when a page is read.
"""

import re

HOMES = (
    (r"(?:\.\./)+CHANGELOG\.md", "/lookup/changelog.md"),
    (r"(?:\.\./)+CONTRIBUTING\.md", "/lookup/contributing.md"),
    (r"(?:\.\./)*gallery/(?P<script>plot_\w+)\.py", r"/generated/gallery/\g<script>.rst"),
    (r"(?:\.\./)*tutorial/(?P<script>plot_\w+)\.py", r"/generated/tutorial/\g<script>.rst"),
)


def turned(text):
    """Text of a Markdown page with its links turned to pages of the site."""
    for there, here in HOMES:
        text = re.sub(rf"\]\({there}(?P<anchor>#[\w-]+)?\)", rf"]({here}\g<anchor>)", text)
    return text


def turn(app, page, source):
    """Turn the links of a page that Sphinx reads."""
    source[0] = turned(source[0])


def setup(app):
    """Turn links as pages are read."""
    app.connect("source-read", turn)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
