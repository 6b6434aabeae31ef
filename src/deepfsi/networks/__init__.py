"""Networks that read counts, and what their answers mean."""
