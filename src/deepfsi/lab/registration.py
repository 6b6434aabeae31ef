"""A reference target, and how a camera shows it: orientation, scale, shift and rotation.

The target is a picture without symmetry. A recording of it tells how scenes lie on the device
before any data are taken: a similarity in one of eight orientations is fitted to the counts behind
the masks.
"""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from deepfsi.base.errors import InputError
from deepfsi.base.files import write_atomically
from deepfsi.base.progress import SILENT, Progress
from deepfsi.camera.layout import DmdLayout
from deepfsi.counting.recording import Recording
from deepfsi.lab.calibration import DisplayedScenes
from deepfsi.patterns.manifest import Manifest

TARGET = np.array(
    [
        [float(each == "#") for each in row]
        for row in (
            "........",
            ".#####..",
            ".#####..",
            ".##.....",
            ".####...",
            ".##...#.",
            ".##.....",
            "........",
        )
    ]
)
"""The target: white blocks on black, unlike itself in all other orientations."""

WELL = {
    "scale": (1.0, 0.05, ""),
    "rotation": (0.0, 3.0, " degrees clockwise"),
    "down": (0.0, 0.02, " of the region's height"),
    "across": (0.0, 0.02, " of the region's width"),
    "blur": (0.0, 0.5, " cells (standard deviation)"),
}
"""Numbers of a target that lies well, the largest departure of each, and its unit.

On validation digits (20 masks at 1e5 photons; MNIST, 16 masks at 1e4) each of the first four costs
1 to 4 points of accuracy where it differs so, and twice as much 3 to 15.
"""


def write_reference(manifest: Manifest, folder: Path) -> None:
    """Write the target to a folder of patterns."""
    from PIL import Image

    if len(manifest.image_shape) != 2:  # masks of one axis have no orientation in a plane
        return
    # Pixels of a block's side, in the proportions of the scenes
    shape = manifest.image_shape
    down, across = (max(1, round(64 * n / max(shape))) for n in shape)
    grey = np.kron(255 * TARGET, np.ones((down, across))).astype(np.uint8)
    picture = io.BytesIO()
    Image.fromarray(grey).save(picture, format="PNG")
    write_atomically(folder / "reference.png", picture.getvalue())


@dataclass(frozen=True)
class _ReferenceFit:
    """Place of the reference target on the device, as a camera shows it."""

    exported: DmdLayout
    layout: DmdLayout  # that masks need to lie on the device as scenes do
    pose: dict[str, float]  # numbers of `WELL`, beyond the orientation
    errors: dict[str, float]  # standard errors of these
    doubt: str | None  # reason why what was found is not certain

    @property
    def departures(self) -> list[str]:
        """Names of the numbers by which scenes lie otherwise than the masks."""
        names = ["orientation"] if self.layout != self.exported else []
        for name, (usual, most, _) in WELL.items():
            # Blur is known less than the rest
            sure = 2.0 * self.errors[name] if name == "blur" else 0.0
            if abs(self.pose[name] - usual) - sure > most:
                names.append(name)
        return names

    @property
    def fits(self) -> bool:
        """True if the target certainly lies as the masks do."""
        return self.doubt is None and not self.departures

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        layouts = {"exported": self.exported, "found": self.layout}
        turns = {
            name: layout.model_dump(include={"flip", "rotate"}) for name, layout in layouts.items()
        }
        verdict = {"fits": self.fits, "doubt": self.doubt, "departures": self.departures}
        return {**verdict, "orientation": turns, "place": self.pose, "errors": self.errors}

    def lines(self) -> Iterator[str]:
        """Say how scenes lie, and whether as the masks do."""
        again = ["--flip"] * self.layout.flip + ["--rotate", str(self.layout.rotate)]
        turned = f"not that of the masks: export again with {' '.join(again)}"
        yield f"orientation: {'as exported' if self.layout == self.exported else turned}"
        for name, (_, _, unit) in WELL.items():
            far = ": too far" if name in self.departures else ""
            yield f"{name}: {self.pose[name]:.3f} ± {self.errors[name]:.3f}{unit}{far}"
        fits = "the scenes lie as the masks do" if self.fits else "the scenes do not fit the masks"
        yield self.doubt or fits


def _doubt(p_value: float, clear: float, errors: dict[str, float]) -> str | None:
    """Reason to doubt a fit, by the p-value of its misfit and the lead of its orientation."""
    if p_value < 1e-6:
        return (
            "no place of the reference explains these counts: show it alone, on black, and give "
            "the patterns that were shown"
        )
    factor = max(errors[name] / WELL[name][1] for name in WELL if name != "blur") ** 2
    # Squared misfits grow with the light; a difference of 25 tells two orientations apart
    factor = max(factor, 25.0 / max(clear, 1e-3))
    if factor <= 1:
        return None
    return f"too little light to be certain: record the reference with {factor:.2g} times as much"


def _image(
    scene: DisplayedScenes, exported: DmdLayout, layout: DmdLayout, pose: np.ndarray
) -> np.ndarray:
    """Light of a mask's pixels (N,) from scale, rotation, shifts and blur of a displayed scene."""
    scale, turn, down, across, blur = pose
    grid = scene.grid
    wide = grid.across * grid.aspect / grid.down
    sides = [1.0, wide] if exported.rotate in (90, 270) else [wide, 1.0]
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    linear = scale * rotation @ np.array(layout.orientation) * sides
    linear = linear / np.array([[wide], [1.0]])
    start = 0.5 + np.array([across, down]) - linear.sum(axis=1) / 2
    view = np.array([*linear[0], start[0], *linear[1], start[1], 0.0, 0.0, abs(blur)])
    seen = scene.images(view)[0]
    out = np.empty(seen.size)
    out[grid.pixels] = seen
    return out


@np.errstate(under="ignore")
def check_view(folder: Path, report: Progress = SILENT) -> _ReferenceFit:
    """Place of scenes on the device, from a counted run of the reference target alone."""
    run = Recording.read(folder)
    counts = run.read_counts().check_photons(folder)
    manifest = run.manifest
    read = counts.lengths_s > 0
    if len(manifest.image_shape) != 2:
        raise InputError("masks of one axis have no orientation: there is no reference for them")
    if read.sum() < 8:  # for five unknowns, and the light of target and surroundings
        raise InputError(
            f"{read.sum()} readouts do not tell where the reference lies, and 8 are needed: record "
            "it with the patterns of `deepfsi dmd export hadamard --size 8x8`"
        )
    usable = counts.expand_to_counts(counts.valid & ~counts.spoilt[:, None])
    if not usable.any():
        raise InputError("no exposure of the reference was counted: record it again")
    signal = counts.signal().sum(axis=(0, 1), where=usable)
    variance = counts.variance.sum(axis=(0, 1), where=usable)
    if manifest.detector_axis:
        signal = signal.sum(axis=-1)
        variance = variance.sum(axis=-1)
    return _fit_place(run.patterns.rails[read], signal[read], variance[read], manifest, report)


def _fit_place(
    masks: np.ndarray,
    counts: np.ndarray,
    variance: np.ndarray,
    manifest: Manifest,
    report: Progress,
) -> _ReferenceFit:
    """Place of the target that explains its counts (k,) behind masks (k, N) best."""
    from scipy import optimize
    from scipy.stats import chi2

    # Error of a readout beside its noise, of the largest: mirrors, edges and print are not exact
    noise = np.sqrt(np.maximum(variance, 1) + (0.003 * counts.max()) ** 2)
    scene = DisplayedScenes(TARGET[None], manifest.grid)
    exported = manifest.layout
    shifts = (-0.2, 0.0, 0.2)
    starts = [
        np.array([scale, 0.0, down, across, 0.3])
        for scale, down, across in product((0.5, 0.7, 1.0, 1.4), shifts, shifts)
    ]
    fits = []
    orientations = exported.orientations()
    for done, layout in enumerate(orientations):
        report(done / len(orientations))

        def misfit(pose: np.ndarray, layout: DmdLayout = layout) -> np.ndarray:
            # Left of the counts over their noise by the target's light, and light spread evenly
            image = _image(scene, exported, layout, pose)
            light = masks @ np.stack([image, np.ones_like(image)], axis=1) / noise[:, None]
            size = np.maximum(np.linalg.norm(light, axis=0), 1e-300)
            weights, _ = optimize.nnls(light / size, counts / noise)
            return np.asarray(counts / noise - (light / size) @ weights)

        # The two best starts of each orientation are followed
        for start in sorted(starts, key=lambda pose: float((misfit(pose) ** 2).sum()))[:2]:
            limits = [0.2, -0.8, -0.6, -0.6, 0.0], [4.0, 0.8, 0.6, 0.6, 2.0]
            step = optimize.least_squares(
                misfit,
                start,
                bounds=limits,
                x_scale=[0.1, 0.1, 0.1, 0.1, 0.3],
                ftol=1e-6,
                xtol=1e-5,
                max_nfev=50,  # a right fit takes some twenty steps, and only wrong ones creep on
            )
            fits.append((2 * step.cost, layout, step))
    fits.sort(key=lambda fit: fit[0])
    cost, layout, best = fits[0]
    rivals = [fit[0] for fit in fits if fit[1] != layout]
    # the second number of a pose is its rotation
    degrees = np.array([1.0, np.degrees(1.0), 1.0, 1.0, 1.0])
    spread = np.sqrt(np.diag(np.linalg.pinv(best.jac.T @ best.jac))) * degrees
    errors = dict(zip(WELL, spread.tolist(), strict=True))
    # 7 unknowns: five of the pose, and the light of target and surroundings
    p_value = float(chi2.sf(cost, max(len(counts) - 7, 1)))
    return _ReferenceFit(
        exported=exported,
        layout=layout,
        pose=dict(zip(WELL, (best.x * degrees).tolist(), strict=True)),
        errors=errors,
        doubt=_doubt(p_value, min(rivals) - cost, errors),
    )
