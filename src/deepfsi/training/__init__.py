"""Learn masks and classifier together."""
