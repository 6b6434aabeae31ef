"""Pictures from counts, without a design, and a test of the light behind masks and inverses."""
