"""Where lines may break: code at spaces, not behind the hyphens of ``--masks``; numbers nowhere.

Long words of code in sentences, tables and headings may break behind a dot, a slash and the like.
A number stays together with its error, its power of ten, its thousands, and a short unit: ± 0.003,
7 · 10⁴, 10 000, 95 %, 3 ms.
"""

import re

CODE = re.compile(r"<pre>.*?</pre>", re.S)
LONG = re.compile(r'(?<=<span class="pre">)[^<]{20,}(?=</span>)')
JOINT = re.compile(r"(?<=\w)[./_:=(]+(?=\w)")
WORD = re.compile(r"(?:&#?\w+;|[^\s&])*-(?:&#?\w+;|[^\s&])*")
PLACES = (r"(?<=±) (?=\d)", r"(?<=\d) (?=[·×] \d)", r"(?<=\d [·×]) (?=\d)", r"(?<=\d) (?=\d{3}\b)")
NUMBER = re.compile("|".join((*PLACES, r"(?<=\d) (?=%|(?:ms|ns|µs|s|MB|GB)\b)")))


def kept(code):
    """Code of a page with each word that has a hyphen kept in one piece."""
    parts = re.split(r"(<[^>]*>)", code)
    parts[::2] = (WORD.sub(r'<span class="word">\g<0></span>', part) for part in parts[::2])
    return "".join(parts)


def whole(body):
    """A page's body in which no line breaks within a number."""
    parts = re.split(r"(<(pre|code|script|style|svg|math)\b.*?</\2>|<[^>]*>)", body, flags=re.S)
    parts[::3] = (NUMBER.sub("\N{NO-BREAK SPACE}", part) for part in parts[::3])
    return "".join(part for place, part in enumerate(parts) if place % 3 != 2)


def breakable(text):
    """HTML with places to break in its long words of code."""
    return LONG.sub(lambda word: JOINT.sub(r"\g<0><wbr>", word[0]), text)


def keep(app, page, template, context, doctree):
    """Keep the short words of all code of a page and its numbers, and let long words break."""
    if "body" in context:
        body = CODE.sub(lambda found: kept(found[0]), context["body"])
        context["body"] = breakable(whole(body))
    for side in ("prev", "next"):
        if context.get(side):
            context[side] = context[side] | {"title": breakable(context[side]["title"])}


def setup(app):
    """Keep words together as pages are written."""
    app.connect("html-page-context", keep)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
