"""The camera study, repeated with the virtual camera."""
