"""A virtual camera and virtual devices: optics, detectors and electronics simulated."""
