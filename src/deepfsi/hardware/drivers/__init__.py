"""Drivers of pattern projectors and photon counters."""
