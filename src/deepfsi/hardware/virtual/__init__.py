"""Virtual camera: detector, optics and devices simulated."""
