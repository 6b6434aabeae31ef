"""Drivers of pattern projectors and photon counters, by their makes."""

from deepfsi.base.registry import Registry


def register(registry: Registry) -> None:
    """Name the drivers, for `deepfsi camera record` and `deepfsi camera live`."""
    registry.add_part("projector", "vialux", "deepfsi_drivers.vialux:VialuxProjector")
    registry.add_part("list projector", "vialux", "deepfsi_drivers.vialux:VialuxLooks")
    registry.add_part("projector", "dlpc900", "deepfsi_drivers.dlpc900:Dlpc900Projector")
    registry.add_part("counter", "picoquant", "deepfsi_drivers.picoquant:SnapiCounter")
    registry.add_part("counter", "swabian", "deepfsi_drivers.swabian:TaggerCounter")
    registry.add_part("counter", "followed", "deepfsi_drivers.file_tail:open_followed")
