"""The light of a run: is it what it should be."""
