"""A page on which a user exposes scenes of their own to a design, without a server."""
