"""Drivers of pattern projectors and photon counters, and what a run asks of them."""
