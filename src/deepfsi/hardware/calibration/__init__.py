"""Calibration of a camera: where each cell of the device looks, and how brightly."""
