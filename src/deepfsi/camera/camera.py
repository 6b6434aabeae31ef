"""A camera, described once: optics, detectors, noise and device, in a laboratory's units.

    scene ──▶ light law, rails, detectors ──▶ counts
              device, times and rates      ──▶ dwells, budget, dark counts

Seconds and counts per second become shares of an exposure and counts here, and nowhere else. Where
no exposure is given it lasts one second, so that a rate is the counts of an exposure.
"""

import os
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from deepfsi.base.arrays import read_npy
from deepfsi.base.errors import InputError, as_input_error, check_choice
from deepfsi.base.files import read_toml
from deepfsi.base.models import Seconds, UserModel
from deepfsi.base.quantities import count_text, time_text
from deepfsi.camera.dead_time import LONGEST_DEAD_TIME_S, DeadTime
from deepfsi.camera.detectors import DetectorMap
from deepfsi.camera.device import Device, find_device
from deepfsi.camera.layout import DmdLayout, Region, find_grid
from deepfsi.camera.names import (
    LIGHT_LAWS,
    LightLawName,
    NoiseFacts,
    NoiseSetting,
    RailsKind,
    Readout,
    find_noise,
    noise_name,
)

NAMES_OF_ONE = ("1x1", "1")
"""Names of one detector that sees all of an image or a spectrum."""

PRESETS: dict[str, dict[str, Any]] = {
    "dmd": {"light": "free-dwell"},
    "dmd-2x2": {"light": "free-dwell", "detectors": "2x2"},
    "dmd-4x4": {"light": "free-dwell", "detectors": "4x4"},
    "two-arm": {"light": "two-arm"},
    "paper": {"light": "column"},
}
"""Cameras by name: one DMD with one, four or sixteen detectors or one on each arm; the paper's."""


def _levels(count: int) -> int:
    if count == 1:
        raise ValueError("one grey level is dark alone: give 2 or more, or 0 for continuous masks")
    return count


Levels = Annotated[int, Field(ge=0, le=2**24), AfterValidator(_levels)]
"""Grey levels, dark included; 0 for continuous masks."""


def _detectors(setting: Any) -> str | tuple[int, ...]:
    """Name or bands as text, or the detector of each pixel, also from a .npy file."""
    name = str(setting).lower() if isinstance(setting, str | int) else ""
    if re.fullmatch(r"[1-9]\d{0,4}(x[1-9]\d{0,4})?", name):
        return name
    if name.endswith(".npy"):
        setting = read_npy(Path(setting))
    labels = np.asarray(setting).ravel()
    if labels.dtype.kind not in "iu":
        raise ValueError(
            "give ROWSxCOLUMNS such as 2x2, a number of bands, or the detector of each pixel as a "
            "whole number from 0, such as a .npy map"
        )
    return tuple(labels.tolist())


def _device(setting: Any) -> Any:
    if not isinstance(setting, str):
        return setting
    if not setting.lower().endswith(".toml"):
        return find_device(setting)
    path = Path(setting)
    with as_input_error(setting):
        return Device.model_validate({"name": path.stem, **read_toml(path)})


OF_NOISES = {
    "dark": "dark counts",
    "dead_time": "dead time",
    "gates": "gates",
    "fluctuation": "light that fluctuates",
}
"""Fields that some noises lack (see `NoiseFacts`), in words."""


class Camera(UserModel):
    """A single-pixel camera, in the units of a laboratory.

    Fields that are left out follow from the others: rails and readout from the light law, the
    shortest frame and the grey levels from the device, the noise from dark counts and read noise.

    Raises
    ------
    InputError
        From `load`, and from whatever takes a camera, in one line that names the field.

    Examples
    --------
    >>> import deepfsi
    >>> camera = deepfsi.Camera(device="dlp7000", exposure="10ms", flux=1e6, dark=200)
    >>> camera.budget, camera.dark_counts
    (10000.0, 2.0)
    >>> round(camera.shortest_share, 6)  # pictures of 44 µs are counted for 32
    0.0032
    """

    light: LightLawName = Field(
        default="free-dwell",
        description="light law of the optics: "
        + "; ".join(f"{name}, {law.optics}" for name, law in LIGHT_LAWS.items()),
    )
    rails: RailsKind = Field(
        default_factory=lambda fields: LIGHT_LAWS[fields["light"]].usual_rails,
        description="dual: signed masks of two frames each; single: non-negative masks; default: "
        "dual for column and two-arm, else single",
    )
    detectors: Annotated[str | tuple[int, ...], BeforeValidator(_detectors)] = Field(
        default="1x1",
        description="detectors, each on its part of the device: ROWSxCOLUMNS, a number of spectral "
        "bands, or each pixel's detector, from 0 (a .npy file)",
    )
    readout: Readout = Field(
        default_factory=lambda fields: LIGHT_LAWS[fields["light"]].usual_readout,
        description="what the network reads of two rails: both, or their difference; default: both "
        "for two-arm, else difference",
    )
    device: Annotated[Device | None, BeforeValidator(_device)] = Field(
        default=None,
        description="micromirror device: a name such as dlp7000, COLUMNSxROWS mirrors, or a "
        "TOML file; it gives the shortest frame and the grey levels",
    )
    region: Region | None = Field(
        default=None,
        description="part of the device that holds the masks, COLUMNSxROWS of mirrors in its "
        "middle or COLUMNSxROWS+LEFT+TOP; default: the largest that its square cells fill",
    )
    stretch: bool = Field(
        default=False, description="cells fill the device or region, and need not be square"
    )
    shortest_dwell: Seconds = Field(
        default_factory=lambda fields: _shortest_frame(fields["device"]),
        description="shortest time for which a frame is counted, such as 32us; default: the "
        "device's shortest picture less settling and 2 us",
    )
    exposure: Seconds | None = Field(
        default=None,
        gt=0,
        description="time of a whole exposure, such as 10ms",
    )
    levels: Levels | None = Field(
        default=None,
        description="grey levels of the masks, dark included: 2 for ON and OFF, 0 for continuous "
        "values; default: one for each mirror of a cell, and dark",
    )
    flux: float | None = Field(
        default=None,
        gt=0,
        le=1e30,
        allow_inf_nan=False,
        description="counts/s with all mirrors of the region ON, for the mean scene",
    )
    dark: float = Field(
        default=0.0,
        ge=0,
        le=1e30,
        allow_inf_nan=False,
        description="dark counts/s of a detector; in an exposure, where no time is given",
    )
    dead_time: Seconds = Field(
        default=0.0, le=LONGEST_DEAD_TIME_S, description="dead time of the counter, such as 20ns"
    )
    dead_time_model: Literal["non-paralysable", "paralysable"] = Field(
        default="non-paralysable",
        description="non-paralysable (a SPAD, a counter's electronics), or paralysable (a "
        "photomultiplier)",
    )
    gates: int = Field(
        default=1,
        ge=1,
        le=1_000_000,  # with more, clicks are as good as Poisson counts
        description="gates of a frame, in each of which a detector clicks at most once; for click "
        "noise",
    )
    noise: NoiseSetting = Field(
        default_factory=lambda fields: (
            "click" if fields["gates"] > 1 else "camera" if fields["dark"] else "poisson"
        ),
        description="noise of the counts: poisson, gaussian, camera (photons, dark counts and "
        "read noise), click (a gated detector that fires at most once in a gate), none, or "
        "module:function of your own; poisson, click with gates, or camera with dark counts",
    )
    sigma: float = Field(
        default_factory=lambda fields: find_noise(fields["noise"]).usual_sigma,
        ge=0,
        allow_inf_nan=False,
        description="read noise of gaussian and camera noise, counts rms per readout; default: 1 "
        "for gaussian, 0 for camera",
    )
    fluctuation: float = Field(
        default=0.0,
        ge=0,
        le=10,
        exclude_if=lambda deviation: not deviation,  # so that older files are the same
        description="relative standard deviation of the light from frame to frame, such as 0.05",
    )

    if TYPE_CHECKING:  # a field has one type, and may be given as others

        def __init__(self, **fields: Any) -> None: ...

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        law = LIGHT_LAWS[self.light]
        noise = find_noise(self.noise)
        one_device = f"{self.light} is not of one device: give light free-dwell, equal-dwell or "
        conflicts = {
            "two-arm with a single rail is not allowed: each arm is a rail; use dual rails": (
                law.arms == 2 and self.rails == "single"
            ),
            f"{one_device}two-arm, or leave device out": self.device and not law.one_device,
            f"{one_device}two-arm, or one detector": not (law.one_device or self.one_detector),
            f"a frame is counted for {self.shortest_dwell:g} s at least: give a longer exposure, "
            "or another device or shortest_dwell": self.exposure
            and self.shortest_dwell >= self.exposure,
            "light fluctuates from frame to frame, and column shows all masks at once: leave "
            "fluctuation out, or give another light": self.fluctuation and not law.in_turn,
        }
        for name, words in OF_NOISES.items():
            stated = getattr(self, name) != type(self).model_fields[name].default
            words = f"{noise.title} has no {words}: leave {name} out, or give another noise"
            conflicts[words] = stated and not getattr(noise, name)
        for words, conflict in conflicts.items():
            if conflict:
                raise ValueError(words)
        return self

    @classmethod
    def load(cls, source: "CameraSource" = None, **settings: Any) -> "Camera":
        """Camera of a source, by default the preset `dmd`, with `settings` replaced.

        A source is a name of `PRESETS`, a file ending in ``.toml``, fields, or a camera.
        """
        fields = {**_fields(source), **settings}
        if "noise" in settings:
            noise = find_noise(settings["noise"])
            for name in OF_NOISES.keys() - settings.keys():
                if not getattr(noise, name):  # the source has it for another noise
                    fields.pop(name, None)
        name = str(source)
        with as_input_error(name if name.lower().endswith(".toml") else ""):
            return cls.model_validate(fields)

    @classmethod
    def of_run(
        cls,
        source: "CameraSource",
        *,
        camera: "CameraSource" = None,
        **settings: Any,
    ) -> "Camera":
        """Camera of a run of a design. Optics that one device cannot have become `free-dwell`.

        A `camera` replaces the source; other parameters as of `load`.
        """
        known = cls.load(source if camera is None else camera)
        if "device" in settings and not LIGHT_LAWS[known.light].one_device:
            known = cls.load(known, light="free-dwell")
        run = cls.load(known, **settings)
        if "dead_time_model" in settings and not run.dead_time:
            raise InputError("`dead_time_model` is of a dead time: give `dead_time`, such as 20ns")
        return run

    @classmethod
    def restored(cls, fields: Mapping[str, Any]) -> "Camera":
        """Camera of a file that holds all fields; fields that follow from others do so again."""
        if "stretch" not in fields:  # of a version that knew no other cells than stretched ones
            fields = {**fields, "stretch": fields.get("device") is not None}
        stored = cls.model_validate(fields)
        known: dict[str, Any] = {}
        special: dict[str, Any] = {}
        for name, field in cls.model_fields.items():
            usual = field.get_default(call_default_factory=True, validated_data=known)
            known[name] = getattr(stored, name)
            if known[name] != usual:
                special[name] = known[name]
        return cls.model_validate(special)

    @property
    def given_fields(self) -> dict[str, Any]:
        """Fields that were given, from which the others follow."""
        return {name: getattr(self, name) for name in self.model_fields_set}

    @property
    def exposure_s(self) -> float:
        """Time of a whole exposure, seconds."""
        return 1.0 if self.exposure is None else self.exposure

    @property
    def shortest_share(self) -> float:
        """Shortest dwell of a frame, as a share of the exposure."""
        return self.shortest_dwell / self.exposure_s

    @property
    def dark_counts(self) -> float:
        """Expected dark counts of a detector in an exposure."""
        return self.dark * self.exposure_s

    @property
    def budget(self) -> float | None:
        """Budget Φ of an exposure of the mean scene, counts; None without a flux."""
        return None if self.flux is None else self.flux * self.exposure_s

    @property
    def rail_count(self) -> int:
        """Rails of each mask, 2 or 1."""
        return {"dual": 2, "single": 1}[self.rails]

    @property
    def noise_name(self) -> str:
        """Name of the noise, or its import path."""
        return noise_name(self.noise)

    @property
    def noise_facts(self) -> NoiseFacts:
        """Facts of its noise under its light."""
        return replace(find_noise(self.noise), steady=not self.fluctuation)

    @property
    def clicks(self) -> int | None:
        """Clicks of a readout at most, its gates; None of detectors that count photons."""
        return self.gates if find_noise(self.noise).gates else None

    @property
    def layout(self) -> DmdLayout:
        """Place of the cells of its masks on the device."""
        return DmdLayout(region=self.region, stretch=self.stretch)

    def mask_levels(self, mask_shape: tuple[int, ...]) -> int:
        """Grey levels of masks of a shape, dark included; 0 for continuous ones."""
        if self.levels is not None:
            return self.levels
        if self.device is None:
            return 0
        return find_grid(self.device, mask_shape, self.layout).mirrors + 1

    def detector_map(self, image_shape: tuple[int, ...]) -> DetectorMap:
        """Detector of each pixel of scenes of a shape."""
        return DetectorMap.of(self.detectors, image_shape)

    @property
    def one_detector(self) -> bool:
        """True if one detector sees all that an arm sends."""
        return self.detectors in NAMES_OF_ONE

    @property
    def counter_dead_time(self) -> DeadTime | None:
        """Dead time of the counter, if it has one."""
        if not self.dead_time:
            return None
        return DeadTime(seconds=self.dead_time, paralysable=self.dead_time_model == "paralysable")

    def describe(self) -> str:
        """The camera in a few lines: its optics, its other fields, and the light of an exposure."""
        shown: dict[str, Any] = dict(self) | {"light": None, "noise": self.noise_name}
        shown["detectors"] = str(self.detectors)[:20]
        for name in ("shortest_dwell", "exposure", "dead_time"):
            shown[name] = shown[name] and time_text(shown[name])
        lines = [f"light law {self.light}: {LIGHT_LAWS[self.light].optics}"]
        if self.device is not None:
            shown["device"] = self.device.name
            lines.append(f"{self.device.columns} x {self.device.rows} mirrors")
        lines.insert(1, ", ".join(f"{name} {value}" for name, value in shown.items() if value))
        if self.shortest_dwell and self.exposure:
            lines.append(f"up to {int(1 / self.shortest_share)} frames in an exposure")
        if self.budget is not None:
            lines.append(f"budget {count_text(self.budget)} counts in an exposure")
        if self.dark:
            lines.append(f"{count_text(self.dark_counts)} dark counts of a detector in an exposure")
        return "\n".join(lines)


CameraSource = str | os.PathLike[str] | Mapping[str, Any] | Camera | None
"""A preset's name, a TOML file, fields, or a camera."""


def _fields(source: CameraSource) -> dict[str, Any]:
    if isinstance(source, Camera):
        return source.given_fields
    if isinstance(source, Mapping):
        return dict(source)
    name = "dmd" if source is None else os.fspath(source)
    if not name.lower().endswith(".toml"):
        check_choice("camera", name, PRESETS)
        return dict(PRESETS[name])
    path = Path(name)
    fields = read_toml(path)
    for field in ("detectors", "device"):  # files are named from where the camera's file is
        file = fields.get(field)
        if isinstance(file, str) and file.lower().endswith((".npy", ".toml")):
            fields[field] = str(path.parent / file)
    return fields


def _shortest_frame(device: Device | None) -> float:
    """Shortest time for which a device's frame is counted, seconds."""
    if device is None:
        return 0.0
    # besides settling, 2 µs of a frame are not counted
    return max(round(device.shortest_us * 1e-6 - device.settle_us * 1e-6 - 2e-6, 12), 0.0)
