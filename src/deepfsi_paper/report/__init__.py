"""Figures of the experiments only, and the page of a study. Reads files; needs no torch."""
