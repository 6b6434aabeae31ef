"""Check a built site: links lead somewhere, nothing is loaded from elsewhere, searches find pages.

Run as ``python docs/check_site.py docs/_build/html``.
"""

import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sphinx.search.en import SearchEnglish

ELSEWHERE = re.compile(r"^(?:https?:)?//")
STYLE_LOADS = re.compile(r"(?:@import\s+['\"]|url\(\s*['\"]?)([^'\")]+)")
NAMED = ("next", "prev", "search")  # links that a browser does not load
TITLE, TERM, PART_OF_TITLE, PART_OF_TERM, ENTRY = 15, 5, 7, 2, 100
"""Scores of Sphinx's `searchtools.js`."""

FIRST = {
    "accuracy photons": "understand/results",
    "checkpoint": "do/cluster",
    "DataLoader": "do/own-loop",
    "DLP6500": "do/dlpc900",
    "DLP7000": "do/alp",
    "GPU": "do/cluster",
    "MATLAB": "do/counts",
    "ONNX": "do/deploy",
    "photon file": "do/camera",
    "Ray": "do/cluster",
    "resume": "do/cluster",
    "Slurm": "do/cluster",
    "TensorBoard": "do/own-loop",
    "time tagger": "do/counts",
    "Windows": "learn/install",
}
"""What one searches for, and the page that the site's search has to give first."""


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


def first(index, query):
    """Page that Sphinx's search gives first, by the rules of its `searchtools.js`."""
    lower, words = query.lower(), re.findall(r"\w+", query.lower())
    scores = {}
    for title, places in index["alltitles"].items():
        if lower in title.lower() and len(lower) >= len(title) / 2:
            for page, _ in places:
                score = round(TITLE * len(lower) / len(title)) + (index["titles"][page] == title)
                scores[page] = max(scores.get(page, 0), score)
    for entry, places in index["indexentries"].items():
        if lower in entry and len(lower) >= len(entry) / 2:
            for page, _, is_main in places:
                if is_main:  # others stand behind all else
                    score = round(ENTRY * len(lower) / len(entry))
                    scores[page] = max(scores.get(page, 0), score)
    stem = SearchEnglish({}).stem
    by_word = [scored(index, stem(word)) for word in words]
    for page in set.intersection(*map(set, by_word)):
        scores[page] = max(scores.get(page, 0), *(found[page] for found in by_word))
    ranks = sorted(scores, key=lambda page: (-scores[page], index["titles"][page].lower()))
    return index["docnames"][ranks[0]] if ranks else "no page"


def scored(index, word):
    """Score of each page that has a word in its text or its titles."""
    scores = {}
    for table, whole, part in (("terms", TERM, PART_OF_TERM), ("titleterms", TITLE, PART_OF_TITLE)):
        terms = index[table]
        exact = word in terms
        for term in [word] if exact else [term for term in terms if word in term]:
            pages = terms[term] if isinstance(terms[term], list) else [terms[term]]
            scores |= dict.fromkeys(pages, whole if exact else part)
    return scores


def lost(site):
    """One line for each search of `FIRST` that gives another page first."""
    text = (site / "searchindex.js").read_text()
    index = json.loads(text[text.index("(") + 1 : text.rindex(")")])
    for query, page in FIRST.items():
        found = first(index, query)
        if found != page:
            yield f"a search for {query!r} gives {found} first, not {page}"


def main():
    """Print the faults of the site that is named; exit code 1 if there are any."""
    site = Path(sys.argv[1]).resolve()
    found = [*faults(site), *lost(site)]
    print("\n".join(found) or "links lead somewhere, nothing comes from elsewhere, searches find")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
