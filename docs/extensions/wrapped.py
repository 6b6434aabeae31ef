"""Where a line of code wraps, options of commands stay whole: no line ends in ``--``."""

import re

CODE = re.compile(r"<pre>.*?</pre>", re.DOTALL)
OPTION = re.compile(r"(?<=[\s>])--?[a-z][\w-]*(?=[\s<])")


def whole(text):
    """HTML with the options of its blocks of code marked, for the style sheet."""
    return CODE.sub(lambda code: OPTION.sub(r'<span class="option">\g<0></span>', code[0]), text)


def mark(app, page, template, context, tree):
    """Mark the options of a page that Sphinx writes."""
    if "body" in context:
        context["body"] = whole(context["body"])


def setup(app):
    """Mark options as pages are written."""
    app.connect("html-page-context", mark)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
