"""Words and numbers that stay in one piece where a line ends.

Code breaks at spaces alone: a browser would break ``--masks`` behind its hyphens. Of the text the
spaces within 10 000, ± 0.01 and 95 % do not break.
"""

import re

CODE = re.compile(r"<pre>.*?</pre>", re.S)
WORD = re.compile(r"[^\s&]*-[^\s&]*")
OTHER = re.compile(r"(<(pre|code|math|script|style)\b.*?</\2>|<[^>]*>)", re.S)
SPACE = re.compile(r"(?<=\d) (?=\d{3}(?!\d))|(?<=±) (?=\d)|(?<=\d) (?=%)")


def kept(code):
    """Code of a page with each word that has a hyphen kept in one piece."""
    parts = re.split(r"(<[^>]*>)", code)
    parts[::2] = (WORD.sub(r'<span class="word">\g<0></span>', part) for part in parts[::2])
    return "".join(parts)


def joined(text):
    """Text of a page with each number in one piece; tags, code and formulas stay as they are."""
    parts = OTHER.split(text)
    parts[::3] = (SPACE.sub("\u00a0", part) for part in parts[::3])
    del parts[2::3]
    return "".join(parts)


def keep(app, page, template, context, doctree):
    """Keep the words of all code of a page, and the numbers of its text."""
    if "body" in context:
        context["body"] = joined(CODE.sub(lambda found: kept(found[0]), context["body"]))


def setup(app):
    """Keep words and numbers together as pages are written."""
    app.connect("html-page-context", keep)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
