"""Where the light of an exposure is lost, from the cells of the device to the counts.

While a scene is in view the light falls on the cells by the clock T, and is counted in gates. Of
the light that arrives is counted

    (1 − Σ waits / T) · throughput · efficiency · registered

with the waits in which no gate is open, the throughput of the masks, the share of photons that a
detector sees, and the share of those that its counter registers. Waits add, as they are parts of
one clock; what follows multiplies. So each cause has a share of what reaches it, which no other
cause changes: of a wait that is its share of the clock.

It stands in this room since it takes both ways in which frames are shown: a pass of all frames, and
a live run, look after look.
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.quantities import Table, count_text, time_text
from deepfsi.camera.camera import Camera
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.hardware.live.observer import margin_ns
from deepfsi.hardware.patterns.folder import FrameSettings
from deepfsi.hardware.patterns.manifest import DesignRails, Manifest
from deepfsi.hardware.patterns.timing import GatePlan

LOSS_CAUSES = {
    "alignment": "all-ON and all-OFF frames",
    "settling": "mirrors that still move",
    "idle": "pictures longer than their gates",
    "loading": "masks that are loaded",
    "decision": "masks that are chosen",
    "off": "mirrors that are OFF",
    "efficiency": "photons that no detector sees",
    "dead_time": "dead time, or gates that fired",
}
"""Causes of a loss in the order in which light meets them, in words."""

HALF = 0.5
"""Time of the faster device to settle and to load, over that of the present one."""


@dataclass(frozen=True)
class LightLoss:
    """One cause."""

    cause: str  # one of `LOSS_CAUSES`
    share: float  # lost of the light that reaches it, 0 to 1
    total: float  # lost of all light that arrives, 0 to 1
    factor: float  # counts without this loss, over those with it


@dataclass(frozen=True)
class CameraChange:
    """A change of the camera, and the counts that it buys."""

    change: str
    factor: float  # counts over the present ones, in the same time by the clock
    words: str  # what these counts are worth


@dataclass(frozen=True)
class LightLosses:
    """Losses of an exposure of one scene."""

    gates_s: float  # time in which photons are counted, seconds
    exposures: int  # exposures that this time holds: as many as fit the pictures of a pass
    waits_s: Mapping[str, float]  # seconds in which none are, by cause
    lit: np.ndarray  # (arms, f)
    dwell: np.ndarray  # (f,), share of the gates' time that each frame has
    efficiency: float  # share of photons that a detector sees
    camera: Camera  # dead time or gates of its counter, and its flux: counts/s with all mirrors ON
    detectors: int
    device: str
    adaptive: bool  # True where masks are made and loaded while the exposure runs

    @classmethod
    def of(
        cls,
        design: DesignRails,
        camera: Camera,
        *,
        counted: float | None = None,
        efficiency: float = 1.0,
        decision_s: float = 0.0,
    ) -> "LightLosses":
        """Losses of a design on a camera with a device and an exposure."""
        device = camera.device
        if not LIGHT_LAWS[camera.light].one_device:
            raise InputError(
                "{given} is no mirror device, whose losses these are: give {light} free-dwell, "
                "equal-dwell or two-arm, or another {camera}",
                setting=("light", "camera"),
                given=camera.light,
            )
        if device is None or camera.exposure is None:
            raise InputError(
                "losses need {device} and {exposure}: give both, or a camera that has them",
                setting=("device", "exposure"),
            )
        if not 0 < efficiency <= 1:
            raise InputError(
                "{efficiency} {given:g} is not allowed: give a share above 0, at most 1",
                setting="efficiency",
                given=efficiency,
            )
        # `picture_s` takes each rail for a frame, and on two arms one frame serves both
        served = 2 if design.two_arm and design.looks is None else 1
        picture_s = design.picture_s(device, served * camera.exposure)
        settings = FrameSettings(device, picture_s, layout=camera.layout)
        patterns = settings.plan(design)
        manifest = patterns.manifest
        gates_s, waits_s = _times(manifest, camera.exposure, decision_s)
        # shares of an exposure may sum to less than 1, and a pass then holds several
        exposures = round(gates_s / (camera.exposure * min(float(manifest.shares.sum()), 1.0)))
        if manifest.looks is not None:
            exposures = 1
        dwell = manifest.shares / manifest.shares.sum()
        open_share = patterns.fractions.mean(axis=1)
        lit = np.stack([open_share, 1 - open_share] if manifest.two_arm else [open_share])
        if counted is not None and not manifest.two_arm:
            even = float(lit[0] @ dwell)
            in_gates = counted * manifest.dimmed * camera.exposure * exposures / gates_s
            lit = np.minimum(lit * in_gates / even, 1.0)
        return cls(
            gates_s=gates_s,
            exposures=exposures,
            waits_s=waits_s,
            lit=lit,
            dwell=dwell,
            efficiency=efficiency,
            camera=camera,
            detectors=manifest.detector_count,
            device=device.name,
            adaptive=bool(manifest.looks and manifest.looks.loads),
        )

    @property
    def clock_s(self) -> float:
        """Time for which the scene is in view, seconds."""
        return self.gates_s + sum(self.waits_s.values())

    @property
    def throughput(self) -> float:
        """Share of the light during gates that detectors see."""
        return float(self.lit.sum(axis=0) @ self.dwell)

    @property
    def registered(self) -> float:
        """Share of the photons that detectors see which their counters register."""
        if self.camera.flux is None:
            return 1.0
        rate = self.camera.flux * self.lit / self.detectors  # of each detector, (arms, f)
        seconds = self.gates_s * self.dwell
        expected = rate * seconds
        if self.camera.clicks is not None:
            open_gates = self.exposures * self.camera.clicks
            counts = -open_gates * np.expm1(-expected / open_gates)
        else:
            counts = self.camera.counter_dead_time.registered(rate) * seconds
        return float(counts.sum() / expected.sum()) if expected.sum() else 1.0

    @property
    def counted(self) -> float:
        """Share of the light that arrives by the clock which is counted."""
        return self.gates_s / self.clock_s * self.throughput * self.efficiency * self.registered

    @property
    def arriving(self) -> float | None:
        """Photons that arrive by the clock; None where no flux is known."""
        if self.camera.flux is None:
            return None
        return self.camera.flux / self.efficiency * self.clock_s

    @property
    def losses(self) -> list[LightLoss]:
        """Each cause, in the order in which light meets them."""
        out = []
        clock_s = self.clock_s
        for cause, wait_s in self.waits_s.items():
            share = wait_s / clock_s
            out.append(LightLoss(cause, share, share, (self.gates_s + wait_s) / self.gates_s))
        left = self.gates_s / clock_s
        kept = {
            "off": self.throughput,
            "efficiency": self.efficiency,
            "dead_time": self.registered,
        }
        for cause, share in kept.items():
            out.append(LightLoss(cause, 1 - share, left * (1 - share), 1 / share))
            left *= share
        return out

    @property
    def changes(self) -> list[CameraChange]:
        """Changes of the camera, compared in the same time by the clock."""
        out = []
        out.append(
            CameraChange(
                "a device twice as fast",
                self._with_waits({"settling": HALF, "loading": HALF}),
                "its mirrors settle, and it takes new masks, in half the time",
            )
        )
        if self.adaptive:
            out.append(
                CameraChange(
                    "masks that are on the device before",
                    self._with_waits({"loading": 0.0}),
                    "nothing is loaded while the scene is in view",
                )
            )
        if len(self.lit) == 1:
            both = replace(self, lit=np.stack([self.lit[0], 1 - self.lit[0]]))
            out.append(
                CameraChange(
                    "a second arm",
                    both._seen / self._seen,
                    "a detector for mirrors that are OFF, light law two-arm: of classes that are "
                    f"equally bright the same masks tell {1 / (1 - self.throughput):.3g} times as "
                    "much",
                )
            )
        twice = replace(self, detectors=2 * self.detectors)
        out.append(
            CameraChange(
                f"{twice.detectors} detectors{'' if len(self.lit) == 1 else ' on each arm'}",
                twice._seen / self._seen,
                "each on its part of the device: the same light, but twice the readouts of a "
                "frame, and less dead time; `deepfsi plan` says how much less light a target then "
                "takes",
            )
        )
        return out

    @property
    def _seen(self) -> float:
        """Share of the light during gates that is counted."""
        return self.throughput * self.efficiency * self.registered

    def _with_waits(self, factors: Mapping[str, float]) -> float:
        """Counts with some waits times factors, over the present ones, in the same time."""
        saved = sum(wait_s * (1 - factors.get(cause, 1)) for cause, wait_s in self.waits_s.items())
        return (self.gates_s + saved) / self.gates_s

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        return {
            "device": self.device,
            "clock_s": self.clock_s,
            "gates_s": self.gates_s,
            "exposures": self.exposures,
            "waits_s": dict(self.waits_s),
            "throughput": self.throughput,
            "efficiency": self.efficiency,
            "registered": self.registered,
            "counted": self.counted,
            "arriving": self.arriving,
            "losses": [asdict(loss) for loss in self.losses],
            "changes": [asdict(change) for change in self.changes],
        }

    def lines(self) -> Iterator[str | Table]:
        """Losses and changes as tables."""
        several = "" if self.exposures == 1 else f", {self.exposures} exposures,"
        yield (
            f"{self.device}: {time_text(self.gates_s)}{several} are counted of "
            f"{time_text(self.clock_s)} by the clock for each scene"
        )
        rows = [
            (
                LOSS_CAUSES[loss.cause],
                f"{loss.share:.1%}",
                f"{loss.total:.1%}",
                f"{loss.factor:.3g}",
            )
            for loss in self.losses
        ]
        rows.append(("counted", "", f"{self.counted:.1%}", ""))
        heads = ("lost to", "of what reaches it", "of all light", "counts without it, times")
        yield Table("Light that arrives at the cells", heads, rows)
        if self.arriving is not None:
            counts = count_text(self.arriving * self.counted)
            yield (
                f"{counts} of {count_text(self.arriving)} photons are counted, of a scene of mean "
                "brightness"
            )
        yield Table(
            "What another camera would count in the same time",
            ("change", "counts, times", "what they are worth"),
            [(each.change, f"{each.factor:.3g}", each.words) for each in self.changes],
            sentences=True,
        )


def _times(
    manifest: Manifest, exposure_s: float, decision_s: float
) -> tuple[float, dict[str, float]]:
    """Time of the gates, seconds, and seconds of each wait of one scene."""
    device = manifest.device
    settle_s = device.settle_us * 1e-6
    ends = len(manifest.frames) - len(manifest.shown)
    if manifest.looks is None:
        gates = GatePlan.of(manifest, exposure_s)
        cost = gates.cost(manifest)
        moving_s = settle_s * ends
        return gates.repeats * float(gates.length_s.sum()), {
            "alignment": cost.sentinels * manifest.pass_s - moving_s,
            "settling": cost.settling * manifest.pass_s + moving_s,
            "idle": cost.idle * manifest.pass_s,
        }
    looks = manifest.looks.count
    frames = looks * (1 if manifest.looks.adaptive else len(manifest.shown))
    gate_ns = np.array(exposure_s / frames * 1e9)
    picture_s = max(
        np.ceil(float(gate_ns + margin_ns(gate_ns)) * 1e-3 + device.settle_us),
        device.shortest_us,
    )
    sentinels_s = float(manifest.picture_s.sum() - manifest.picture_s[manifest.shown].sum())
    load_s = (device.load_us or 0) * 1e-6 * manifest.looks.loads
    # the all-OFF frame after each look stays while the next is chosen, and is a picture, too
    rest_s = max(device.shortest_us * 1e-6 - load_s - decision_s, 0.0)
    return exposure_s, {
        "alignment": sentinels_s,  # these last as long, however mirrors settle
        "settling": settle_s * frames,
        "idle": float(frames * (picture_s * 1e-6 - settle_s) - exposure_s) + looks * rest_s,
        "loading": looks * load_s,
        "decision": looks * decision_s,
    }
