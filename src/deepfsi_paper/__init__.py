"""The experiments of Lu and Velten, *Deep Feature-specific Imaging*, and ours beside them."""

from deepfsi.base.registry import Registry


def register(registry: Registry) -> None:
    """Name the experiments, images seen patch by patch, and the transformer that reads them."""
    registry.add_scheme("patches", ("patch",), "deepfsi_paper.patches.settings:Patches")
    registry.add_command(
        "reproduce",
        "deepfsi_paper.commands:ReproducePaper",
        "Repeat an experiment of the paper: figures, the numbers behind them, and its claims.",
    )
    registry.add_part("classifier", "vit", "deepfsi_paper.patches.settings:VIT")
