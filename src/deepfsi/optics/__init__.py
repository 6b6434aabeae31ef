"""Light and masks: photon budgets, noise, light laws, sensing matrices and the scanner."""
