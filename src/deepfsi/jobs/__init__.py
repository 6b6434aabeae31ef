"""What is asked for: a design, its masks, exposure and training (no torch)."""
