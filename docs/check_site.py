"""Check a built site: every internal link leads somewhere, and nothing is loaded from elsewhere.

Run as ``python docs/check_site.py docs/_build/html``.
"""

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ELSEWHERE = re.compile(r"^(?:https?:)?//")
STYLE_LOADS = re.compile(r"(?:@import\s+['\"]|url\(\s*['\"]?)([^'\")]+)")
NAMED = ("next", "prev", "search")  # links that a browser does not load


class Page(HTMLParser):
    """Anchors of a page, where its links lead, and what it loads."""

    def __init__(self, text):
        super().__init__()
        self.anchors, self.links, self.loads = {""}, [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        """Note an element's id, its link, and the files that a browser loads for it."""
        given = dict(attrs)
        self.anchors |= {given[key] for key in ("id", "name") if given.get(key)}
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        elif tag == "link" and given.get("rel") not in NAMED:
            self.loads.append(given["href"])
        elif given.get("src"):
            self.loads.append(given["src"])
        self.loads += STYLE_LOADS.findall(given.get("style") or "")


def faults(site):
    """One line for each bad link and for each file that a page would load from elsewhere."""
    every = (path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts)
    pages = {path: Page(path.read_text()) for path in every}
    for path, page in pages.items():
        name = path.relative_to(site)
        for address in page.loads:
            if ELSEWHERE.match(address):
                yield f"{name}: loads {address}"
        for address in page.links + page.loads:
            if not urlsplit(address).scheme and not leads_somewhere(path, address, pages):
                yield f"{name}: nothing at {address}"
    for path in sorted(site.rglob("*.css")):
        for address in STYLE_LOADS.findall(path.read_text()):
            if ELSEWHERE.match(address):
                yield f"{path.relative_to(site)}: loads {address}"


def leads_somewhere(path, address, pages):
    """Say if a link of a page leads to a file of the site and, in a page, to an anchor."""
    parts = urlsplit(address)
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if target not in pages:
        return target.is_file()
    return unquote(parts.fragment) in pages[target].anchors


def main():
    """Print the faults of the site that is named; exit code 1 if there are any."""
    site = Path(sys.argv[1]).resolve()
    found = list(faults(site))
    print("\n".join(found) or "every internal link leads somewhere, nothing comes from elsewhere")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
