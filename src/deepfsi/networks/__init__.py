"""Networks that read counts."""
