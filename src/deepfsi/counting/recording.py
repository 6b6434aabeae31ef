"""The folder of a recording: what was shown and recorded, and photons counted frame by frame.

    acquisition.json   scenes, exposure, settle time (`Acquisition`)
    patterns/          manifest.json, mirrors.npy and the design of the patterns shown, no frames
    photons.ptu        photons and frame markers, written by a counter, `camera import` or virtually
    counts.npz         photons of each readout (`Counts`), written by `count`
    calibration/       spot scans and flat fields, if there are any

Markers say when frames start; photons are counted in windows of these; the counts are corrected for
what the counter does, and the light is checked. A recording can be counted again for another
exposure: gates are shorter or longer, and as many follow each other in a frame as there are
repeats.
"""

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from shutil import copyfile
from typing import Any, Self

import numpy as np

from deepfsi.base.errors import InputError, as_input_error
from deepfsi.base.files import hash_file, new_folder, read_regular, read_text, write_atomically
from deepfsi.base.progress import SILENT, Progress
from deepfsi.base.quantities import count_text, time_text
from deepfsi.camera.dead_time import NO_DEAD_TIME, DeadTime
from deepfsi.counting.acquisition import Acquisition, Calibration
from deepfsi.counting.checks import check_light
from deepfsi.counting.counts import (
    ENDS,
    Corrections,
    Counts,
    light_of_clicks,
    refuse_photon_settings,
)
from deepfsi.counting.flux import Arrivals, name_inputs
from deepfsi.counting.reader import PtuFile
from deepfsi.counting.windows import MOST_DRIFT, FrameStarts, WindowCounts, Windows
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.manifest import GatePlan, Manifest


@dataclass(frozen=True)
class Recording:
    """Folder of a recording: its settings, and the patterns that were shown."""

    folder: Path
    acquisition: Acquisition
    patterns: Patterns

    @classmethod
    def prepare(
        cls,
        folder: str | os.PathLike[str],
        patterns: Patterns,
        acquisition: Acquisition,
        photons: Path | None = None,
    ) -> Self:
        """Make the folder of a recording, with a copy of its photon file if it has one."""
        source = patterns.folder
        assert source is not None
        names = ["manifest.json", "mirrors.npy"]
        if patterns.manifest.design_sha256:
            names.append(Patterns.DESIGN)
        content = {
            name: read_regular(source / name, 2**32, "export the patterns again") for name in names
        }
        digest = sha256(content["manifest.json"]).hexdigest()
        if acquisition.manifest_sha256 not in (None, digest):
            raise InputError(f"the acquisition is of other patterns than those in {source}")
        acquisition = acquisition.model_copy(update={"manifest_sha256": digest})
        acquisition.check(patterns.manifest, "the acquisition")
        with new_folder(folder) as draft:
            (draft / "calibration").mkdir()
            (draft / "patterns").mkdir()
            for name, data in content.items():
                (draft / "patterns" / name).write_bytes(data)
            (draft / "acquisition.json").write_bytes(acquisition.model_dump_json(indent=1).encode())
            if photons is not None:
                copyfile(photons, draft / "photons.ptu")
        return cls(Path(folder), acquisition, patterns)

    @classmethod
    def read(cls, folder: str | os.PathLike[str]) -> Self:
        """Settings and patterns of a recording; `InputError` if they do not fit."""
        path = Path(folder) / "acquisition.json"
        prepare = "make the folder with `deepfsi camera import` or `simulate`"
        content = read_text(path, 2**24, prepare)
        with as_input_error(str(path)):
            acquisition = Acquisition.model_validate_json(content)
        patterns = Patterns.read(path.parent / "patterns")
        manifest = path.parent / "patterns" / "manifest.json"
        if hash_file(manifest) != acquisition.manifest_sha256:
            raise InputError(
                f"{manifest} is not the one that {path} was made with: copy the patterns that were "
                f"shown, or {prepare}"
            )
        acquisition.check(patterns.manifest, str(path))
        return cls(Path(folder), acquisition, patterns)

    @property
    def manifest(self) -> Manifest:
        """Frames in the order in which they were shown."""
        return self.patterns.manifest

    @property
    def photons(self) -> Path:
        """File of the photons and markers."""
        return self.folder / "photons.ptu"

    def keep_first(self, scenes: int) -> None:
        """Write to the folder of a run that was stopped that it has its first scenes alone."""
        kept = self.acquisition.model_copy(update={"scenes": self.acquisition.scenes[:scenes]})
        content = kept.model_dump_json(indent=1).encode()
        write_atomically(self.folder / "acquisition.json", content)

    def count(
        self,
        *,
        exposure_s: float | None = None,
        dead_time: DeadTime | None = None,
        gains: tuple[float, ...] = (),
        click_gates: int | None = None,
        progress: Progress = SILENT,
    ) -> Counts:
        """Count the photons of each readout, and write counts.npz.

        The folder says what is None: the exposure, and the dead time that is corrected. Gains are
        efficiencies of detectors, relative to their mean. Each gate of a frame is divided into
        `click_gates` ones that count their first photon alone. Raises `InputError` if the photon
        file is missing or damaged, gates do not fit the frames, markers do not follow the schedule,
        or no pass has light.
        """
        self.acquisition.check_fixed(self.folder)
        if exposure_s is not None and (self.acquisition.camera or {}).get("gates"):
            # Virtual detectors of earlier versions recorded the clicks alone
            raise InputError(
                f"{self.folder} holds the first photons alone of its gates: leave the exposure out"
            )
        if click_gates is not None:
            refuse_photon_settings(dead_time, *gains)
        corrections = Corrections.of(self._dead_time(dead_time), self.manifest, gains)
        gates = self.acquisition.gates(self.manifest, exposure_s, click_gates=click_gates or 1)
        shortest_s = float(gates.length_s.min()) / (click_gates or 1)
        source, starts = _find_frames(self, gates, shortest_s, progress.between(0.0, 0.4))
        if click_gates is None:
            windows = Windows.of_gates(self.manifest, gates, starts)
        else:
            windows = Windows.of_clicks(self.manifest, gates, click_gates)
        inputs = self.acquisition.inputs
        windowed = starts.count_in(source, windows, inputs, progress.between(0.4, 1.0))
        if click_gates is None:
            fields = _count_photons(self, gates, windowed, corrections)
        else:
            fields = _count_clicks(self, gates, windowed, click_gates)
        counts = Counts(
            **fields,
            valid=np.ones((len(self.acquisition.scenes), gates.repeats), bool),
            exposure_s=gates.exposure_s,
            settle_s=gates.settle_s,
            lengths_s=self.manifest.lengths_by_readout(gates.length_s),
            drift=starts.drift,
            inputs=inputs,
            gains=gains,
            gates=click_gates,
        )
        counts.save(self._counts_file, self.photons, self.acquisition.digest)
        return counts

    def _dead_time(self, stated: DeadTime | None) -> DeadTime:
        """Dead time to correct: the stated one, else the calibration's, else none."""
        calibration = self.folder / "calibration"
        if stated is None and (calibration / "calibration.json").is_file():
            stated = Calibration.load(calibration).dead_time
        return stated or NO_DEAD_TIME

    def read_counts(self) -> Counts:
        """Counts that `count` wrote; `InputError` if settings or photons changed since."""
        return Counts.read(self._counts_file, self.photons, self.acquisition.digest)

    @property
    def _counts_file(self) -> Path:
        return self.folder / "counts.npz"

    def as_dict(self, counts: Counts) -> dict[str, Any]:
        """JSON types only: its counts, and faults with the names of scenes."""
        names = [scene.name for scene in self.acquisition.scenes]
        faults = [
            fault.model_dump() | {"name": None if fault.scene is None else names[fault.scene]}
            for fault in counts.faults
        ]
        return {
            "scenes": len(counts.counts),
            "exposures": counts.valid.size,
            "exposure_s": counts.exposure_s,
            "photons_counted": int(counts.counts.sum()),
            "photons": [None if math.isnan(flux) else flux for flux in counts.photons.tolist()],
            "dark_rate": counts.dark_rate.tolist(),
            "drift": counts.drift,
            "inputs": [number + 1 for number in counts.inputs],
            "dead_time_s": counts.dead_time.seconds,
            "arrivals": float(counts.arrivals.sum()),
            "gains": list(counts.gains),
            "gates": counts.gates,
            "problems": list(PtuFile(self.photons).header.problems),
            "faults": faults,
            "counts": counts.counts.tolist(),
        }

    def lines(self, counts: Counts) -> Iterator[str]:
        """Say what was counted, its faults, and what was corrected."""
        for problem in PtuFile(self.photons).header.problems:
            yield f"{self.photons.name}: {problem}"
        names = [scene.name for scene in self.acquisition.scenes]
        for fault in counts.faults:
            yield fault.words(names)
        if counts.dead_time.seconds:
            yield f"dead time of {counts.dead_time} is corrected"
        if counts.gains:
            yield f"efficiencies corrected: {', '.join(f'{gain:.3f}' for gain in counts.gains)}"
        kind = "photons" if counts.gates is None else f"clicks of up to {counts.gates} a frame"
        stated = counts.gates is not None and self.acquisition.flux in counts.flux
        source = "that acquisition.json states" if stated else "by the all-ON frames"
        yield (
            f"{len(counts.counts)} scenes, {counts.valid.size} exposures of "
            f"{time_text(counts.exposure_s)}, {int(counts.counts.sum())} {kind} counted"
        )
        yield f"budget {source}: {_span(counts.photons)} photons an exposure"
        yield f"dark counts: {_span(counts.dark_rate)} a second"
        yield f"counts: {self._counts_file}"


def _span(values: np.ndarray) -> str:
    """Least and largest of the values that are numbers."""
    if np.isnan(values).all():
        return "unknown"
    ends = [count_text(end) for end in (np.nanmin(values), np.nanmax(values))]
    return " to ".join(dict.fromkeys(ends))


def _find_frames(
    recording: Recording,
    gates: GatePlan,
    shortest_s: float,
    progress: Progress,
) -> tuple[PtuFile, FrameStarts]:
    """Photons of a recording and its frames, whose shortest gate the counter must resolve."""
    manifest = recording.manifest
    source = PtuFile(recording.photons)
    tick_s = source.header.tick_s
    # A gate of fewer than ten ticks is counted too coarsely
    if shortest_s < 10 * tick_s:
        raise InputError(
            f"{recording.photons} has times in steps of {time_text(tick_s)}, too coarse for "
            f"gates of {time_text(shortest_s)}: give a longer exposure"
        )
    starts = FrameStarts.find(source, recording.acquisition, manifest, progress)
    # Gates do not fit frames that are much shorter than planned
    pictures = starts.pictures_s[manifest.mask_frames]
    room = pictures - gates.settle_s
    over = gates.repeats * gates.length_s - room - MOST_DRIFT * pictures
    if over.max() > 0:
        exposure = float((room / manifest.shares).min()) / gates.repeats
        raise InputError(
            f"{recording.photons} has frames {-starts.drift:.2%} shorter than planned, and "
            f"{gates.repeats} exposures do not fit: give --exposure {exposure:.4g} or less"
        )
    return source, starts


def _check_lit(recording: Recording, lit: np.ndarray) -> None:
    """Raise `InputError` if no pass has light."""
    if not lit.any():
        raise InputError(
            f"{recording.photons} has no light on input "
            f"{name_inputs(recording.acquisition.inputs)}: no all-ON frame is brighter than the "
            "all-OFF ones. Write the input of the detector, as `deepfsi camera inspect` lists "
            "them, into acquisition.json, give the patterns that were shown, export them with "
            "--invert if mirrors are inverted, or switch on the lamp"
        )


def _count_photons(
    recording: Recording, gates: GatePlan, windowed: WindowCounts, corrections: Corrections
) -> dict[str, Any]:
    """Fields of the counts: photons of each readout, and arrivals."""
    manifest = recording.manifest
    inputs = recording.acquisition.inputs
    photons, spent = windowed.per_frame()
    rates = photons / spent[..., None]
    corrections.check(rates, manifest.frames, inputs, str(recording.photons))
    factors = corrections.factors(rates)
    arrivals = Arrivals(
        manifest.frames, photons * factors.arrivals, photons * factors.variance, spent
    )
    light = check_light(arrivals, manifest, inputs)
    _check_lit(recording, light.lit)
    counts = windowed.gates(gates.repeats)  # (S, R, f, inputs)
    of_masks = (slice(None), None, manifest.mask_frames)
    return {
        "counts": manifest.by_readout(counts),
        "arrivals": manifest.by_readout(counts * factors.arrivals[of_masks]),
        "variance": manifest.by_readout(counts * factors.variance[of_masks]),
        "flux": light.flux,
        "dark_rate": manifest.by_rail(light.dark_rate),
        "faults": light.faults,
        "dead_time": corrections.dead_time,
    }


def _count_clicks(
    recording: Recording, gates: GatePlan, windowed: WindowCounts, click_gates: int
) -> dict[str, Any]:
    """Clicks of each readout: gates of a detector that hold a photon or more."""
    manifest = recording.manifest
    fired = replace(windowed, photons=np.minimum(windowed.photons, 1))
    clicks = fired.gates(gates.repeats * click_gates)
    clicks = clicks.reshape(len(clicks), gates.repeats, click_gates, *clicks.shape[2:])
    counts = manifest.by_readout(clicks.sum(axis=2))
    flux, dark_rate = light_of_clicks(
        windowed.per_frame()[0][:, ENDS],
        fired.per_frame()[0][:, ENDS],
        gates=click_gates,
        width_s=float(windowed.windows.length_s[0]),
        manifest=manifest,
    )
    _check_lit(recording, np.array(not flux <= 0))  # NaN: too few gates stay without a click
    # Where clicks do not tell the flux, it is the one that was stated
    flux = flux if np.isfinite(flux) else recording.acquisition.flux or np.nan
    return {
        "counts": counts,
        "arrivals": counts.astype(float),
        "variance": counts * (1 - counts / click_gates),  # binomial, G p (1 − p), p = counts / G
        "flux": np.full(len(counts), flux),
        "dark_rate": manifest.by_rail(np.tile(dark_rate, (len(counts), 1))),
        "faults": (),
    }
