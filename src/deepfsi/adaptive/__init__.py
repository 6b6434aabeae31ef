"""Masks that are made while the camera looks, of the counts so far: prior, choice and exposure."""
