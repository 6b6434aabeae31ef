"""Learn masks and classifier together, several designs side by side."""
