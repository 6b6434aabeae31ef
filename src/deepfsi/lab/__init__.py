"""Design and camera together: counts to classes, data of a design, calibration, looks."""
