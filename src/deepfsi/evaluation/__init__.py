"""How well designs work, and why."""
