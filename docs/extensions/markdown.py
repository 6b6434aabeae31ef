"""Markdown that a directive makes while the site is built."""

from sphinx.util.docutils import SphinxDirective


def cell(text):
    """Text in one cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")


def table(heads, rows, kind):
    """Table of texts, in a box of the class that `site.css` lays out on narrow screens."""
    lines = [heads, ["---"] * len(heads), *([cell(each) for each in row] for row in rows)]
    told = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    return f":::{{div}} {kind}\n{told}\n:::"


class Made(SphinxDirective):
    """A directive whose content is the Markdown of `text`."""

    has_content = True

    def run(self):
        """Parse it where the directive stands."""
        return self.parse_text_to_nodes(self.text(), allow_section_headings=True)
