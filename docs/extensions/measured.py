"""Numbers of `numbers.toml` in pages: ``{{ looks.8-1e4 }}`` is a value.

``{{ looks.8-1e4 ± }}`` is the value with its interval, ``{{ looks.8-1e4 of 100 }}`` the value as a
whole number of 100. Pages outside of the notebook write no accuracy of their own.
"""

import re
import tomllib
from pathlib import Path

FILE = Path(__file__).parents[1] / "numbers.toml"
QUOTE = re.compile(r"\{\{ ([\w-]+)\.([\w-]+)( ±| of 100)? \}\}")
CODE = re.compile(r"^(`{3,})(?!\{).*?^\1|(?<!`)`[^`\n]+`(?!`)", re.M | re.S)
UNIT = r"(?! ?(?:[nmµ]?s|[kMG]?B|pixels|cells|[RGB])\b)"
THREE = re.compile(rf"(?<![\d.·×])0\.(?!00)\d{{3,4}}(?!\d|\.\d){UNIT}")
TWO = re.compile(rf"(?<![\d.·×])0\.\d\d(?!\d|\.\d){UNIT}|(?<=recognises )\d\d\b")
ACCURATE = re.compile("accura|recogni|correct|rightly|classif", re.I)


def groups():
    """Groups of the file by their names."""
    return tomllib.loads(FILE.read_text())


def filled(text, found=None):
    """Text of a page with its quotes filled in; a KeyError names a number that is not there."""
    found = found or groups()

    def number(quote):
        text = found[quote[1]]["numbers"][quote[2]][0]
        if quote[3] == " ±":
            return text
        value = text.partition(" ")[0]
        return f"{100 * float(value):.0f}" if quote[3] else value

    return QUOTE.sub(number, text)


def accuracies(text):
    """Accuracies that a page writes itself, in no code and no quote.

    They are numbers 0.ddd from 0.01 on. In lines that speak of accuracy they are 0.dd, too, and
    the number of "recognises dd".
    """
    found = []
    for line in CODE.sub("", text).splitlines():
        found += THREE.findall(line)
        found += TWO.findall(line) if ACCURATE.search(line) else []
    return found


def fill(app, page, source):
    """Fill in the quotes of a page that Sphinx reads."""
    app.env.note_dependency(str(FILE))
    source[0] = filled(source[0])


def setup(app):
    """Fill in numbers as pages are read."""
    app.connect("source-read", fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
