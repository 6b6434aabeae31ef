"""Pages of reports: what a reader and a parser see of them."""

import itertools
import re
import subprocess
import sys
from html.parser import HTMLParser


def words_of(page):
    """Text that a reader sees, without styles and scripts."""
    bare = re.sub(r"<(style|script).*?</\1>", "", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", bare))


class Wellformed(HTMLParser):
    """Collects ids and addresses, and checks that elements close in order."""

    VOID = frozenset(("meta", "path", "use", "image", "circle", "rect", "br", "img"))

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.addresses = [], [], []

    def handle_starttag(self, tag, attrs):
        self.ids += [value for name, value in attrs if name == "id"]
        self.addresses += [v for name, v in attrs if name in ("src", "href", "xlink:href")]
        self.addresses += re.findall(r"url\(([^)]*)\)", " ".join(v or "" for _, v in attrs))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):  # also of an element that is closed where it opens
        if tag not in self.VOID:
            assert self.open.pop() == tag


def assert_whole(page, home, files=frozenset()):
    """Elements close, ids differ, and addresses are of the page, of its figures, or of files."""
    parser = Wellformed()
    parser.feed(page)
    assert parser.open == []
    assert len(parser.ids) == len(set(parser.ids))
    for address in parser.addresses:
        drawn = address == "figures/" and (home / address).is_dir()
        assert drawn or address.startswith(("data:image/svg+xml;base64,", "#")) or address in files
        assert address[0] != "#" or address[1:] in parser.ids
    assert files <= set(parser.addresses)
    assert not re.search(r"https?:|//fonts|@import", page)


def assert_headed(page):
    """One h1, and no heading more than one level below the one before it."""
    levels = [int(level) for level in re.findall(r"<h([1-6])\b", page)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(below <= above + 1 for above, below in itertools.pairwise(levels)), levels


def run_without_torch(code, folder):
    """Run a line of Python with a folder, which may import neither torch nor pyplot."""
    code += "; assert not {'torch', 'matplotlib.pyplot'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", f"import sys; {code}", str(folder)], check=True)
