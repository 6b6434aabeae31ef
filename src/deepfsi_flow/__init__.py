"""Scenes that pass a static pattern: their exposure, transits in photon files, photomasks."""

from deepfsi.base.registry import Registry


def register(registry: Registry) -> None:
    """Name the exposure and the commands."""
    settings = "bins", "speed", "jitter", "speed_jitter", "pattern_width"
    registry.add_scheme("passing", settings, "deepfsi_flow.settings:Passing")
    registry.add_command(
        "mask",
        "deepfsi_flow.commands:WriteMask",
        "Write the static pattern that scenes pass for a photomask, with its scale.",
    )
    registry.add_command(
        "camera transits",
        "deepfsi_flow.commands:FindTransits",
        "Find the transits in a photon file without markers, count their bins, and classify them.",
    )
