"""Patterns for a micromirror device: what is shown when, and the files that hold it."""
