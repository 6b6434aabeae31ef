"""Light and masks: photon budgets, noise, light constraints, sensing matrices and the scanner."""
