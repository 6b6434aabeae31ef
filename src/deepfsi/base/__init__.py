"""What any program needs: errors, files, locks, progress, interrupts, quantities. Quick to load."""
