"""The light of a run, checked against what it should be."""
