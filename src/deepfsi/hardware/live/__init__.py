"""Live and recorded runs: devices show and count; a live run decides what is shown next."""
