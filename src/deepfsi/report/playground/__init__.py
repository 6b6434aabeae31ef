"""A page on which a user exposes scenes of their own to a design, without a server."""

from deepfsi.report.playground.page import write_page

__all__ = ["write_page"]
