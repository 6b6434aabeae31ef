"""Images seen patch by patch, with a detector for each, and read by a transformer."""
