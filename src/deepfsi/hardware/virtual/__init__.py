"""The virtual camera: detector, optics and devices simulated."""
