"""Drivers of pattern projectors and photon counters, by their makes."""

from deepfsi.base.registry import Registry


def register(registry: Registry) -> None:
    """Name the drivers, for `deepfsi camera record` and `deepfsi camera live`."""
    registry.add_device("projector", "vialux", "deepfsi_drivers.vialux:VialuxProjector")
    registry.add_device("list projector", "vialux", "deepfsi_drivers.vialux:VialuxLooks")
    registry.add_device("projector", "dlpc900", "deepfsi_drivers.dlpc900:Dlpc900Projector")
    registry.add_device("list projector", "dlpc900", "deepfsi_drivers.dlpc900:refuse_lists")
    registry.add_device("counter", "picoquant", "deepfsi_drivers.picoquant:SnapiCounter")
    registry.add_device("counter", "swabian", "deepfsi_drivers.swabian:open_tagger")
    registry.add_device("counter", "followed", "deepfsi_drivers.file_tail:open_followed")
