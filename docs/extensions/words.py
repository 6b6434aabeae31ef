"""Code whose lines break at spaces alone: a browser would break ``--masks`` behind its hyphens.

Long words of code in sentences, tables and headings may break behind a dot, a slash and the like.
"""

import re

CODE = re.compile(r'<pre>.*?</pre>|<div class="[^"]*messages.*?</div>', re.S)
LONG = re.compile(r'(?<=<span class="pre">)[^<]{20,}(?=</span>)')
JOINT = re.compile(r"(?<=\w)[./_:=(]+(?=\w)")
WORD = re.compile(r"(?:&#?\w+;|[^\s&])*-(?:&#?\w+;|[^\s&])*")


def kept(code):
    """Code of a page with each word that has a hyphen kept in one piece."""
    parts = re.split(r"(<[^>]*>)", code)
    parts[::2] = (WORD.sub(r'<span class="word">\g<0></span>', part) for part in parts[::2])
    return "".join(parts)


def breakable(text):
    """HTML with places to break in its long words of code."""
    return LONG.sub(lambda word: JOINT.sub(r"\g<0><wbr>", word[0]), text)


def keep(app, page, template, context, doctree):
    """Keep the short words of all code of a page, and let long ones break."""
    if "body" in context:
        body = CODE.sub(lambda found: kept(found[0]), context["body"])
        context["body"] = breakable(body)
    for side in ("prev", "next"):
        if context.get(side):
            context[side] = context[side] | {"title": breakable(context[side]["title"])}


def setup(app):
    """Keep words together as pages are written."""
    app.connect("html-page-context", keep)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
