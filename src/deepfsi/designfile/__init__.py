"""What was learned: design files in NumPy, and what counts say of them (no torch)."""
