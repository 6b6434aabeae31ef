"""Patterns for a micromirror device: frames, their times and gates, and their files."""
