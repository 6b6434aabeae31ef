"""Comparisons as HTML pages and figures. Reads files; needs no torch."""
