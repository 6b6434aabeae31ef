"""The experiments of Lu and Velten, *Deep Feature-specific Imaging*, and ours beside them."""

from deepfsi.base.registry import Registry


def register(registry: Registry) -> None:
    """Name images seen patch by patch, and the transformer that reads them."""
    registry.add_scheme("patches", ("patch",), "deepfsi_paper.patches.settings:Patches")
    registry.add_part("classifier", "vit", "deepfsi_paper.patches.settings:VIT")
