"""A recorded acquisition: its folder, and photon timestamps turned into counts."""
