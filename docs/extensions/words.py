"""Code whose lines break at spaces alone: a browser would break ``--masks`` behind its hyphens."""

import re

CODE = re.compile(r"<pre>.*?</pre>", re.S)
WORD = re.compile(r"[^\s&]*-[^\s&]*")


def kept(code):
    """Code of a page with each word that has a hyphen kept in one piece."""
    parts = re.split(r"(<[^>]*>)", code)
    parts[::2] = (WORD.sub(r'<span class="word">\g<0></span>', part) for part in parts[::2])
    return "".join(parts)


def keep(app, page, template, context, doctree):
    """Keep the words of all code of a page."""
    if "body" in context:
        context["body"] = CODE.sub(lambda found: kept(found[0]), context["body"])


def setup(app):
    """Keep words together as pages are written."""
    app.connect("html-page-context", keep)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
