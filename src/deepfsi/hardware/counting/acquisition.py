"""The folder of a recording: what was shown and recorded, and photons counted frame by frame.

    acquisition.json   scenes, exposure, settle time (`Acquisition`)
    patterns/          manifest.json, mirrors.npy and the design of the patterns shown, no frames
    photons.ptu        photons and frame markers, as the vendor's software or a virtual camera wrote
    counts.npz         photons of each readout (`Counts`), written by `count`
    reference.json     what the reference target showed (`Verdict`), where it was kept
    calibration/       spot scans and flat fields, if there are any

A recording can be counted again for another exposure: gates are shorter or longer, and as many
follow each other in a frame as there are repeats.
"""

import os
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from deepfsi.base import (
    InputError,
    StrictModel,
    as_input_error,
    hash_file,
    new_folder,
    read_regular,
    read_text,
    time_text,
    write_atomically,
)
from deepfsi.camera import LiveSettings
from deepfsi.hardware.patterns.folder import companions, read_patterns
from deepfsi.hardware.patterns.sequence import Manifest, Patterns
from deepfsi.hardware.patterns.timing import (
    Gates,
    find_gates,
    longest_exposure,
    usual_tolerance,
)

MOST_READOUTS = 2**21
"""Gates, and readouts, that are counted at once, at most."""

MOST_FRAMES = 2**20
"""Frames of all passes together, times the detectors of an arm, at most."""

MOST_INPUTS = 64
"""Inputs of a photon counter at most."""

LARGEST_JSON = 2**24
"""Bytes of acquisition.json at most."""

LARGEST_COMPANION = 2**32
"""Bytes of a file beside the manifest of patterns at most."""

VERDICT = "reference.json"
"""File of what the reference target showed, in the folder of a run of scenes."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
"""Finite number above 0."""


class Scene(StrictModel):
    """One scene of a recording."""

    name: str = Field(max_length=1000)  # By which results name it
    label: str | None = Field(None, max_length=1000)  # Its class, where that is known
    # Of its picture as the design of the patterns sees it, where there is one: tells scenes that
    # the design was trained on (`design.training_data.scene_hashes`)
    hash: str | None = Field(None, pattern="^[0-9a-f]{8}$")

    @model_serializer(mode="wrap")
    def _without_none(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Fields without a hash that is none, as those of acquisitions before there were any."""
        held: dict[str, Any] = dump(self)
        return {name: each for name, each in held.items() if name != "hash" or each is not None}


class Acquisition(StrictModel):
    """Settings of a recording: one pass over the patterns for each scene, one after another."""

    schema_version: Literal[1] = 1
    # In the order of their passes
    scenes: tuple[Scene, ...] = Field(min_length=1, max_length=2**16)
    exposure_s: Positive  # Total exposure over the masks' frames, seconds
    # Time before the first gate of each frame, seconds
    settle_s: float = Field(ge=0, allow_inf_nan=False)
    repeats: int = Field(ge=1, le=MOST_READOUTS)  # Gates in each frame
    # Which of the counter's marker inputs the device's trigger is wired to
    marker_bit: Literal[1, 2, 4, 8] = 1
    # Of the counter, 0 for input 1: one for each detector; on two arms first those that see mirrors
    # ON, then those that see mirrors OFF
    inputs: tuple[Annotated[int, Field(ge=0, lt=MOST_INPUTS)], ...] = Field(
        (0,), min_length=1, max_length=MOST_INPUTS
    )
    # Photons/s on the device for the training scenes' mean, where known
    flux: Positive | None = None
    camera: dict[str, Any] | None = None  # Settings of a virtual camera
    seed: int | None = None  # Of a virtual recording
    # Of a run whose dwells were chosen from counts; `shown.jsonl` then says what was shown
    live: LiveSettings | None = None
    # Of the bytes of patterns/manifest.json; `prepare` fills it in
    manifest_sha256: str | None = Field(None, pattern=r"^[0-9a-f]{64}$")

    @model_validator(mode="after")
    def _distinct(self) -> Self:
        if len(set(self.inputs)) < len(self.inputs):
            raise ValueError("each detector needs an input of its own")
        return self

    def rewired(self, inputs: tuple[int, ...] | None, marker_bit: int | None) -> Self:
        """Settings with other inputs of the counter, as far as given, or `InputError`."""
        needed = len(self.inputs)
        if inputs is not None and len(inputs) != needed:
            raise InputError(
                f"{len(inputs)} inputs are given, and {needed} are needed: one for each detector"
            )
        given = {"inputs": inputs, "marker_bit": marker_bit}
        changes = {name: value for name, value in given.items() if value is not None}
        with as_input_error():
            return type(self).model_validate(self.model_dump() | changes)

    @property
    def digest(self) -> str:
        """Hash of the settings."""
        return sha256(self.model_dump_json().encode()).hexdigest()


class Verdict(StrictModel):
    """Findings of `camera check` on a run of the reference target, kept with a run of scenes."""

    reference: str  # folder of that run
    fits: bool  # true if scenes certainly lie as the masks do, and are sharp
    reasons: tuple[str, ...]  # against it

    def keep(self, run: str | os.PathLike[str]) -> Path:
        """Write it to the folder of a run of scenes of the same patterns."""
        digests = [read_acquisition(each)[0].manifest_sha256 for each in (self.reference, run)]
        if len(set(digests)) > 1:
            raise InputError(
                f"{run} was recorded with other patterns than {self.reference}: record the "
                "reference with those that were shown"
            )
        return write_atomically(Path(run) / VERDICT, self.model_dump_json(indent=1).encode())

    @classmethod
    def of(cls, run: Path) -> Self | None:
        """Verdict that is kept with a run; none where none is."""
        if not (run / VERDICT).is_file():
            return None
        again = "check again with `deepfsi camera check --keep`"
        with as_input_error(str(run / VERDICT), again):
            return cls.model_validate_json(read_regular(run / VERDICT, LARGEST_JSON, again))

    @property
    def words(self) -> str:
        """The verdict in a line."""
        if self.fits:
            return "the reference target of these patterns lies as the masks do, and is sharp"
        return (
            f"the reference target of these patterns, {self.reference}, does not fit "
            f"({'; '.join(self.reasons)}): mend the optics or export again, and record again"
        )


def plan_acquisition(
    manifest: Manifest,
    scenes: tuple[Scene, ...],
    *,
    exposure_s: float | None = None,
    settle_s: float | None = None,
    repeats: int | None = None,
    **others: Any,
) -> Acquisition:
    """Settings for a recording of patterns."""
    others = {"inputs": tuple(range(manifest.inputs)), **others}
    settle = manifest.device.settle_us * 1e-6 if settle_s is None else settle_s
    exposure = exposure_s
    if exposure is None:
        longest = longest_exposure(manifest, settle + usual_tolerance(manifest))
        exposure = max(longest, 0) / (repeats or 1)
    gates = find_gates(manifest, exposure, settle, repeats)
    readouts = len(scenes) * manifest.readouts
    countable = max(MOST_READOUTS // max(readouts, 1), 1)
    check_inputs(manifest, MOST_INPUTS, "a counter")
    with as_input_error():
        return Acquisition(
            scenes=scenes,
            exposure_s=exposure,
            settle_s=settle,
            repeats=repeats or min(gates.repeats, countable),
            **others,
        )


def prepare(
    folder: str | os.PathLike[str],
    patterns_folder: str | os.PathLike[str],
    acquisition: Acquisition,
) -> Acquisition:
    """Make the folder of a recording, to which photons.ptu is then added."""
    source = Path(patterns_folder)
    patterns = read_patterns(source)
    names = ["manifest.json", "mirrors.npy", *companions(patterns.manifest)]
    content = {
        name: read_regular(source / name, LARGEST_COMPANION, "export the patterns again")
        for name in names
    }
    digest = sha256(content["manifest.json"]).hexdigest()
    if acquisition.manifest_sha256 not in (None, digest):
        raise InputError(f"the acquisition is of other patterns than those in {source}")
    acquisition = acquisition.model_copy(update={"manifest_sha256": digest})
    _check_fit(acquisition, patterns.manifest, "the acquisition")
    with new_folder(folder) as draft:
        (draft / "calibration").mkdir()
        (draft / "patterns").mkdir()
        for name, held in content.items():
            (draft / "patterns" / name).write_bytes(held)
        (draft / "acquisition.json").write_bytes(acquisition.model_dump_json(indent=1).encode())
    return acquisition


def keep_first(folder: Path, acquisition: Acquisition, count: int) -> None:
    """Write to the folder of a run that was stopped that it has its first scenes alone."""
    kept = acquisition.model_copy(update={"scenes": acquisition.scenes[:count]})
    write_atomically(folder / "acquisition.json", kept.model_dump_json(indent=1).encode())


def read_acquisition(folder: str | os.PathLike[str]) -> tuple[Acquisition, Patterns]:
    """Settings and patterns of a recording, checked for consistency."""
    path = Path(folder) / "acquisition.json"
    hint = "make the folder with `deepfsi camera prepare` or `simulate`"
    content = read_text(path, LARGEST_JSON, hint)
    with as_input_error(str(path), content=content):
        acquisition = Acquisition.model_validate_json(content)
    patterns = read_patterns(path.parent / "patterns")
    manifest = path.parent / "patterns" / "manifest.json"
    if acquisition.manifest_sha256 is None:
        raise InputError(
            f"{path} has no manifest_sha256, so nothing says that {manifest} was shown: make the "
            "folder with `deepfsi camera prepare`"
        )
    if hash_file(manifest) != acquisition.manifest_sha256:
        raise InputError(
            f"{manifest} is not the one that {path} was made with: copy the patterns that were "
            "shown"
        )
    _check_fit(acquisition, patterns.manifest, str(path))
    return acquisition, patterns


def _check_fit(acquisition: Acquisition, manifest: Manifest, name: str) -> None:
    """Raise `InputError` unless these patterns can be recorded so."""
    roles = [frame.role for frame in manifest.frames]
    ends = ["on", "off"]
    if len(roles) < 5 or roles[:2] != ends or roles[-2:] != ends or set(roles[2:-2]) != {"mask"}:
        raise InputError(
            f"{name} has patterns without an all-ON and an all-OFF frame at both ends: export them "
            "with `deepfsi dmd export`"
        )
    if len(acquisition.inputs) != manifest.inputs:
        raise InputError(
            f"{name} has {len(acquisition.inputs)} inputs, and its patterns need "
            f"{manifest.inputs}: give one for each detector"
        )
    most = MOST_FRAMES // manifest.detector_count
    if len(acquisition.scenes) * len(roles) > most:
        raise InputError(
            f"{name} has {len(acquisition.scenes)} scenes of {len(roles)} frames, and at most "
            f"{most} frames are allowed: split it"
        )
    if acquisition.live:
        if manifest.looks is None:
            raise InputError(f"{name} is of a live run, and its patterns are of no several looks")
        return
    if manifest.looks is not None:
        raise InputError(
            f"{name} has patterns of several looks, which are chosen while the exposure runs: use "
            "`deepfsi camera live`"
        )
    try:
        gates_of(acquisition, manifest)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def check_fixed(acquisition: Acquisition, folder: str | os.PathLike[str]) -> None:
    """Raise `InputError` if the recording in a folder is a live run, of other frames each scene."""
    if acquisition.live:
        raise InputError(
            f"{folder} is a live run, in which each scene had frames of its own: use `deepfsi "
            "camera count` and `classify`"
        )


def gates_of(
    acquisition: Acquisition,
    manifest: Manifest,
    exposure_s: float | None = None,
    settle_s: float | None = None,
    repeats: int | None = None,
) -> Gates:
    """Gates to count an acquisition of a manifest's patterns with. Parameters as of `count`."""
    same = exposure_s is None and settle_s is None
    wanted = acquisition.repeats if repeats is None and same else repeats
    exposure = acquisition.exposure_s if exposure_s is None else exposure_s
    settle = acquisition.settle_s if settle_s is None else settle_s
    gates = find_gates(manifest, exposure, settle, wanted)
    shortest = min(manifest.picture_s[[0, 1, -2, -1]]) - usual_tolerance(manifest)
    if settle >= shortest:
        raise InputError(
            f"a settle time of {time_text(settle)} leaves nothing of the all-ON and all-OFF "
            "frames: give "
            f"less than {shortest:g}"
        )
    each = len(acquisition.scenes) * manifest.readouts
    most = MOST_READOUTS // each
    if most < 1:
        raise InputError(
            f"{len(acquisition.scenes)} scenes of {manifest.masks} masks are more than "
            f"{MOST_READOUTS} readouts: split the acquisition"
        )
    if gates.repeats <= most:
        return gates
    if wanted is not None:
        raise InputError(f"{wanted} repeats are too many to count at once: give at most {most}")
    return Gates(gates.settle_s, gates.length_s, most)


def check_inputs(manifest: Manifest, most: int, name: str) -> None:
    """Raise `InputError` if a counter, or its files, have fewer inputs than there are detectors."""
    if manifest.inputs > most:
        raise InputError(
            f"{name} has up to {most} inputs, and these patterns need {manifest.inputs}, one for "
            "each detector: use a counter with more, or a design with fewer `detectors`"
        )
