"""Code whose lines break at spaces alone: a browser would break ``--masks`` behind its hyphens.

Names of modules break behind their dots where they stand as headings and in links to the next page.
"""

import re

CODE = re.compile(r'<pre>.*?</pre>|<div class="[^"]*messages.*?</div>', re.S)
HEADING = re.compile(r"<h1>.*?</h1>", re.S)
MODULE = re.compile(r"(?<=\w)[._](?=\w+[\w.]*</span>)")
WORD = re.compile(r"[^\s&]*-[^\s&]*")


def kept(code):
    """Code of a page with each word that has a hyphen kept in one piece."""
    parts = re.split(r"(<[^>]*>)", code)
    parts[::2] = (WORD.sub(r'<span class="word">\g<0></span>', part) for part in parts[::2])
    return "".join(parts)


def broken(title):
    """Title with a place to break behind each dot and underscore of a module's name."""
    return MODULE.sub(r"\g<0><wbr>", title)


def keep(app, page, template, context, doctree):
    """Keep the words of all code of a page, and break names of modules in links to others."""
    if "body" in context:
        body = CODE.sub(lambda found: kept(found[0]), context["body"])
        context["body"] = HEADING.sub(lambda found: broken(found[0]), body)
    for side in ("prev", "next"):
        if context.get(side):
            context[side] = context[side] | {"title": broken(context[side]["title"])}


def setup(app):
    """Keep words together as pages are written."""
    app.connect("html-page-context", keep)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
