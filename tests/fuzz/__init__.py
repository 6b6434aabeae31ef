"""Fuzzing of all readers of what users give."""
