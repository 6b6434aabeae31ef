"""The apparatus as a user describes it: optics, device, detectors, noise, light (no torch)."""
