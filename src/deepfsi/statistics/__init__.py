"""Confidence intervals; knows nothing of designs."""
