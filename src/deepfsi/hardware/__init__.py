"""The camera: patterns for a micromirror device, photon files, a virtual laboratory (no torch)."""
