"""Markdown that a directive makes while the site is built."""

from sphinx.util.docutils import SphinxDirective


def cell(text):
    """Text in one cell of a table."""
    return " ".join(text.split()).replace("|", "\\|")


def table(heads, rows):
    """Table of texts."""
    lines = [heads, ["---"] * len(heads), *([cell(each) for each in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


class Made(SphinxDirective):
    """A directive whose content is the Markdown of `text`."""

    has_content = True

    def run(self):
        """Parse it where the directive stands."""
        return self.parse_text_to_nodes(self.text(), allow_section_headings=True)
