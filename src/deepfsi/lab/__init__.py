"""Design and camera together: runs, live runs, classes, calibration, a virtual camera."""
