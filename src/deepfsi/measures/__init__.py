"""What answers are measured by: one table, and the results of tests made with it (no torch)."""
