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

WELL = {"scale": 0.05, "shift": 0.02, "rotation": 3.0}
"""Departures that are well: share of 1, share of the region's side, degrees.

On validation digits (20 masks at 1e5 photons; MNIST, 16 masks at 1e4) each costs 1 to 4 points of
accuracy, and twice as much 3 to 15.
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
class ReferenceFit:
    """Place of the reference target on the device, as a camera shows it."""

    exported: DmdLayout
    layout: DmdLayout  # that masks need to lie on the device as scenes do
    scale: float  # of the target's image, over that of the region
    shift: tuple[float, float]  # of its middle, down and across, shares of the region's sides
    rotation: float  # beyond the orientation's, degrees clockwise
    blur: float
    blur_error: float
    errors: tuple[float, float, float, float]  # standard errors of scale, shifts and rotation
    chance: float  # of a misfit as large
    clear: float  # difference of the squared misfits from the next best orientation

    @property
    def doubt(self) -> str | None:
        """Reason why what was found is not certain; None where it is."""
        # Chance of the counts' misfit below which no place of the target explains them
        if self.chance < 1e-6:
            return (
                "no place of the reference explains these counts: show it alone, on black, and "
                "give the patterns that were shown"
            )
        limits = WELL["scale"], WELL["shift"], WELL["shift"], WELL["rotation"]
        more = max(error / most for error, most in zip(self.errors, limits, strict=True)) ** 2
        # Difference of the squared misfits by which one orientation must fit better than all others
        more = max(more, 25.0 / max(self.clear, 1e-3))
        if more <= 1:
            return None
        return f"too little light to be certain: record the reference with {more:.2g} times as much"

    @property
    def fits(self) -> bool:
        """True if the target certainly lies as the masks do."""
        return self.doubt is None and not any(departs for _, _, departs in self.findings)

    def as_dict(self) -> dict[str, Any]:
        """JSON types only."""
        layouts = {"exported": self.exported, "found": self.layout}
        numbers = ("scale", "shift", "rotation", "blur", "blur_error", "errors")
        return {
            "fits": self.fits,
            "doubt": self.doubt,
            "orientation": {
                name: {"flip": layout.flip, "rotate": layout.rotate}
                for name, layout in layouts.items()
            },
            **{name: getattr(self, name) for name in numbers},
        }

    def lines(self) -> Iterator[str]:
        """Say how scenes lie, and whether as the masks do."""
        for what, words, departs in self.findings:
            far = ": too far" if departs and what != "orientation" else ""
            yield f"{what}: {words}{far}"
        fits = "the scenes lie as the masks do" if self.fits else "the scenes do not fit the masks"
        yield self.doubt or fits

    @property
    def findings(self) -> list[tuple[str, str, bool]]:
        """Name and text of each finding, and whether it departs from what was exported."""
        scale, down, across, turn = self.errors
        turned = self.layout != self.exported
        words = "as exported"
        if turned:
            given = ["--flip"] * self.layout.flip
            given += [f"--rotate {self.layout.rotate}"] * bool(self.layout.rotate)
            again = " ".join(given) or "neither --flip nor --rotate"
            words = f"not that of the masks: export again with {again}"
        down_across = (
            f"{self.shift[0]:+.1%} ± {down:.1%} down, {self.shift[1]:+.1%} ± {across:.1%} across, "
            "of the region"
        )
        rotation = f"{self.rotation:+.1f} ± {turn:.1f} degrees clockwise"
        blur = f"{self.blur:.2f} ± {self.blur_error:.2f} cells (standard deviation)"
        return [
            ("orientation", words, turned),
            ("scale", f"{self.scale:.3f} ± {scale:.3f}", abs(self.scale - 1) > WELL["scale"]),
            ("shift", down_across, max(map(abs, self.shift)) > WELL["shift"]),
            ("rotation", rotation, abs(self.rotation) > WELL["rotation"]),
            # Blur is known less than the place; half a cell is well
            ("blur", blur, self.blur - 2.0 * self.blur_error > 0.5),
        ]


def _image(
    scene: DisplayedScenes, exported: DmdLayout, layout: DmdLayout, place: np.ndarray
) -> np.ndarray:
    """Light of a mask's pixels (N,) from scale, rotation, shifts and blur of a displayed scene."""
    scale, turn, down, across, blur = place
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
def check_view(folder: Path, report: Progress = SILENT) -> ReferenceFit:
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
    usable = counts.by_readout(counts.valid & ~counts.spoilt[:, None])
    if not usable.any():
        raise InputError("no exposure of the reference was counted: record it again")
    signal = counts.signal().sum(axis=(0, 1), where=usable)
    variance = counts.variance.sum(axis=(0, 1), where=usable)
    if manifest.several:
        signal = signal.sum(axis=-1)
        variance = variance.sum(axis=-1)
    return _fit_place(run.patterns.rails[read], signal[read], variance[read], manifest, report)


def _fit_place(
    masks: np.ndarray,
    counts: np.ndarray,
    variance: np.ndarray,
    manifest: Manifest,
    report: Progress,
) -> ReferenceFit:
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

        def misfit(place: np.ndarray, layout: DmdLayout = layout) -> np.ndarray:
            # Left of the counts over their noise by the target's light, and light spread evenly
            image = _image(scene, exported, layout, place)
            light = masks @ np.stack([image, np.ones_like(image)], axis=1) / noise[:, None]
            size = np.maximum(np.linalg.norm(light, axis=0), 1e-300)
            parts, _ = optimize.nnls(light / size, counts / noise)
            return np.asarray(counts / noise - (light / size) @ parts)

        # The two best starts of each orientation are followed
        for start in sorted(starts, key=lambda place: float((misfit(place) ** 2).sum()))[:2]:
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
    spread = np.sqrt(np.diag(np.linalg.pinv(best.jac.T @ best.jac)))
    others = [fit[0] for fit in fits if fit[1] != layout]
    scale, turn, down, across, blur = best.x.tolist()
    return ReferenceFit(
        exported=exported,
        layout=layout,
        scale=scale,
        shift=(down, across),
        rotation=float(np.degrees(turn)),
        blur=blur,
        blur_error=float(spread[4]),
        errors=(spread[0], spread[2], spread[3], float(np.degrees(spread[1]))),
        chance=float(chi2.sf(cost, max(len(counts) - 7, 1))),
        clear=min(others) - cost,
    )
