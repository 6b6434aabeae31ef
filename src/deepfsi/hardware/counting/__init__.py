"""Photons to counts: frames found by markers, gates counted, counts corrected; tables, too."""
