"""Photon files: timestamps read, also while they arrive, counted in windows, and written."""
