"""The vision transformer with an optical front end."""
