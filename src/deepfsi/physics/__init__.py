"""Masks, light and noise: what the light does between a scene and the counts."""
