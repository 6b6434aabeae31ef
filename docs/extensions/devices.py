"""The directive `devices`: a table of the micromirror devices that the package knows."""

from markdown import Made, table

from deepfsi.camera.device import DEVICES

HEADS = ["device", "mirrors, pitch", "controller, frames held", "shortest, µs"]


class Devices(Made):
    """The directive."""

    def text(self):
        """Markdown of the table."""
        return table(HEADS, [row(device) for device in DEVICES.values()])


def row(device):
    """Cells of a device."""
    lattice = ", diamond" if device.lattice == "diamond" else ""
    mirrors = f"{device.columns}x{device.rows}, {device.pitch_um} µm{lattice}"
    held = f"{device.controller}, {device.patterns}" if device.patterns else device.controller
    return f"`{device.name}`", mirrors, held, f"{device.shortest_us:g}"


def setup(app):
    """Add the directive."""
    app.add_directive("devices", Devices)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
