"""Adaptive masks before a detector that clicks at most once a look, where a click has a price."""

from deepfsi.base.registry import Registry


def register(registry: Registry) -> None:
    """Name the training of these masks."""
    registry.add_part("adaptive", "click", "deepfsi_clicks.clicking:ClickTraining")
