"""How well a design works, and why: tests, ideal observer, bounds, confidence, early stopping."""
