"""Finished designs: masks and network in one object, its file, and its graph."""
