"""The loop that shows, counts and decides what to show next."""
