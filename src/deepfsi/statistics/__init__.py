"""Confidence intervals and significance tests; knows nothing of designs."""
