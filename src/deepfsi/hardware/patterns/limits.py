"""Limits of a device that a sequence of frames has to keep: how many frames, and for how long."""

from deepfsi.base import InputError
from deepfsi.camera import DEVICE_SOURCES, DEVICES, Device
from deepfsi.hardware.patterns.sequence import Manifest


def check_stored(device: Device, frames: int) -> None:
    """Raise `InputError` if a controller does not hold as many frames."""
    if device.patterns is None or frames <= device.patterns:
        return
    larger = [
        f"{one.name} ({one.patterns or 'as many as fit its memory'})"
        for one in DEVICES.values()
        if not one.video_us and (one.patterns is None or one.patterns >= frames)
    ]
    raise InputError(
        f"{frames} frames do not fit {device.name}, whose controller holds "
        f"{device.patterns}: use fewer masks (of a scan: a smaller --size), or a device that holds "
        f"them, such as {', '.join(larger[:3])}"
    )


def check_limits(manifest: Manifest) -> None:
    """Raise `InputError` unless the device of a manifest can show all of its frames."""
    device, looks = manifest.device, manifest.looks
    check_stored(device, len(manifest.frames))
    if looks and looks.adaptive and device.load_us is None:
        able = ", ".join(one.name for one in DEVICES.values() if one.load_us)
        raise InputError(
            f"adaptive masks are loaded while the run goes on, and {device.name} takes no frame "
            f"then: use {able}, or a device file with its `load_us`"
        )
    for place, frame in enumerate(manifest.frames):
        if not device.shortest_us <= frame.picture_us <= device.longest_us:
            raise InputError(
                f"frame {place} ({frame}) lasts {frame.picture_us} µs, and {device.name} shows "
                f"{device.shortest_us} to {device.longest_us} µs: export again with another "
                "--exposure"
            )
    times = {frame.picture_us for frame in manifest.frames}
    if device.video_us and len(times) > 1:
        raise InputError(
            f"frames last {min(times)} to {max(times)} µs, and {device.name} shows all for one "
            "time: export the patterns for it again"
        )


def departures(device: Device) -> list[str]:
    """Limits of a named device that are wider than those of its documents, one line each."""
    known = DEVICES.get(device.name)
    if known is None or device.shortest_us >= known.shortest_us:
        return []
    return [
        f"shortest picture {device.shortest_us} µs, and {device.name} needs {known.shortest_us} "
        f"({DEVICE_SOURCES[device.name]['shortest_us']}): export without --shortest unless you "
        "know why"
    ]
