"""Provenance of a design: its `info`, and the hashes of its training scenes.

A design keeps the job of its training with its camera; the name or path of its data with the
options that load it; the hash of the training scenes, and the number of scenes left out. It also
keeps a short hash of each training scene, by which a test tells them from new scenes, and small
thumbnails of pictures of one's own: cut, resized or compressed again they are recognised.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import Any

import numpy as np

from deepfsi.base.errors import as_input_error
from deepfsi.base.intervals import wilson
from deepfsi.base.models import StrictModel
from deepfsi.camera.camera import Camera
from deepfsi.datasets.alike import likeness, thumbnails
from deepfsi.datasets.catalog import DATASETS
from deepfsi.datasets.dataset import Dataset, Origin

MOST_THUMBNAILS = 4096
"""Training pictures of which a design keeps thumbnails, at most: of about 200 bytes each."""


@dataclass(frozen=True, eq=False)
class TrainingScenes:
    """What a design remembers of its training scenes, n of them."""

    hashes: np.ndarray  # (n,) int32, rising
    thumbnails: np.ndarray | None = None  # (n, h, w) uint8, in the order of the hashes
    # Likeness to one of them, beyond which a picture is recognised as trained on
    limit: float = 1.0

    @classmethod
    def of(cls, data: Dataset) -> "TrainingScenes":
        """Those of the training, and of held-out scenes."""
        x = np.concatenate([data.x_train, *([data.x_test] if data.held_out else [])])
        numbers = _numbers(scene_hashes(x, data.image_shape))
        hashes, first = np.unique(numbers, return_index=True)
        own = data.origin is not None and data.origin.data not in DATASETS
        if not own or len(data.image_shape) != 2 or len(hashes) > MOST_THUMBNAILS:
            return cls(hashes)
        small = thumbnails(x[first].reshape(-1, *data.image_shape))
        # As like as they are to different ones of them, new pictures may be, too
        groups = np.append(data.alike, -1 - np.arange(len(x) - len(data.x_train)))[first]
        nearest = likeness(small, small)
        nearest[groups[:, None] == groups] = 0
        limit = float(np.quantile(nearest.max(axis=1), 0.995).clip(0.9, 0.999))
        return cls(hashes, small, limit)

    @classmethod
    def restored(cls, arrays: Mapping[str, np.ndarray]) -> "TrainingScenes | None":
        """Those of a design file; None of older versions."""
        hashes, small, limit = map(arrays.get, SCENE_ARRAYS)
        if hashes is None or small is None or limit is None:
            return None if hashes is None else cls(hashes)
        return cls(hashes, small, float(limit[0]))

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays as a design file takes them."""
        values = [self.hashes]
        if self.thumbnails is not None:
            values += [self.thumbnails, np.array([self.limit])]
        return dict(zip(SCENE_ARRAYS, values, strict=False))

    def nearest(self, pictures: np.ndarray) -> np.ndarray:
        """Index (n,) of the training picture as which each of (n, H, W) is recognised, or -1."""
        if self.thumbnails is None:
            return np.full(len(pictures), -1)
        alike = likeness(thumbnails(pictures), self.thumbnails)
        return np.where(alike.max(axis=1) > self.limit, alike.argmax(axis=1), -1)


SCENE_ARRAYS = ("training_scenes", "training_thumbnails", "training_limit")
"""Names of the arrays of a design file that tell its training scenes."""


class TrainedOn(StrictModel):
    """Data of a training, an entry of `Design.info`."""

    name: str  # of the data set without the scenes that were left out
    hash: str
    held_out: int = 0  # last training scenes that were left out
    origin: Origin | None = None  # none for arrays in memory, and for scenes changed after loading

    @property
    def words(self) -> str:
        """Data, and scenes left out."""
        left = f", its last {self.held_out} training scenes left out" if self.held_out else ""
        return (self.origin.words if self.origin else f"{self.name}, in memory") + left

    @classmethod
    def of(cls, data: Dataset) -> "TrainedOn":
        """The data of a training, as a design remembers it."""
        return cls(name=data.name, hash=data.hash, held_out=data.held_out, origin=data.origin)

    def is_of(self, data: Dataset) -> bool:
        """True if a data set is the one that was trained on, the scenes left out included."""
        if not 0 <= self.held_out < len(data.x_train):
            return False
        kept = data.hold_out(self.held_out) if self.held_out else data
        return kept.hash == self.hash


def trained_on(info: Mapping[str, Any]) -> TrainedOn | None:
    """Data in the `info` of a design; None for one that was made without any."""
    if "data" not in info:
        return None
    with as_input_error("the design's training data", "train it again"):
        return TrainedOn.model_validate(info["data"])


def scene_hashes(scenes: np.ndarray, image_shape: tuple[int, ...]) -> tuple[str, ...]:
    """Short hash, in hex, of each of scenes (n, ...), rounded to levels."""
    # Images are rounded as `write_pictures` does, so that a scene keeps its hash when it is written
    # as a picture and read again
    kind: type[np.unsignedinteger] = np.uint8 if len(image_shape) == 2 else np.uint16
    levels = np.iinfo(kind).max
    return tuple(
        blake2b(row.astype(kind), digest_size=4).hexdigest()
        for row in (np.rint(scene.ravel() * levels).clip(0, levels) for scene in scenes)
    )


def known_hashes(
    training: TrainingScenes | None, pictures: np.ndarray, image_shape: tuple[int, ...]
) -> list[str]:
    """Hashes of pictures (n, ...); one that is recognised has that of the training picture."""
    hashes = list(scene_hashes(pictures, image_shape))
    if training is not None:
        for row, index in enumerate(training.nearest(pictures.reshape(-1, *image_shape))):
            if index >= 0:
                hashes[row] = int(training.hashes[index]).to_bytes(4, "big", signed=True).hex()
    return hashes


def _numbers(hashes: Iterable[str]) -> np.ndarray:
    """Hashes (n,) as int32."""
    return np.frombuffer(bytes.fromhex("".join(hashes)), ">i4").astype(np.int32)


def was_trained_on(
    training: TrainingScenes | None, hashes: Iterable[str | None]
) -> list[bool | None]:
    """Whether each scene was trained on, by the training's hashes (n,); None where unknown."""
    scenes = list(hashes)
    if training is None:
        return [None] * len(scenes)
    # All at once: a search through all training scenes takes milliseconds
    known = _numbers(scene for scene in scenes if scene is not None)
    answers = iter(np.isin(known, training.hashes).tolist())
    return [None if scene is None else next(answers) for scene in scenes]


def new_scenes(training: TrainingScenes | None, data: Dataset) -> tuple[Dataset, str | None]:
    """Data whose test scenes are new to a design, and a sentence on what was left out.

    If the design was trained on all of them they stay, and the sentence says so. The test part of a
    `hold_out` stays: it is known to belong to the training.
    """
    if training is None or data.held_out:
        return data, None
    old = np.isin(_numbers(scene_hashes(data.x_test, data.image_shape)), training.hashes)
    count = int(old.sum())
    if count == 0:
        return data, None
    if count == len(old):
        measure = "no number here says how good the design is"
        return data, f"all {count} test scenes were trained on: {measure}"
    fresh = replace(data, x_test=data.x_test[~old], y_test=data.y_test[~old])
    was, are = ("was", "is") if count == 1 else ("were", "are")
    return fresh, f"{count} of the {len(old)} test scenes {was} trained on, and {are} left out"


def trained_camera(info: Mapping[str, Any]) -> Camera | None:
    """Camera that a design was trained for; None of files of older versions."""
    fields = info.get("job", {}).get("camera")
    with as_input_error("the design's camera", "train it again"):
        return None if fields is None else Camera.restored(fields)


def trained_budgets(info: Mapping[str, Any]) -> tuple[float, ...]:
    """Lowest and highest budget of a training; none where a design does not say."""
    job = info.get("job", {})
    if "photons" not in job:
        return ()
    return job["photons"], job["photons"] * job.get("exposure", {}).get("span", 1.0)


_KINDS = {
    "new": (False, "{}s, none recognised as trained on"),
    "trained_on": (True, "{}s that were trained on, no measure of the design"),
    "unknown": (None, "{}s that may have been trained on"),
}
"""Scenes by whether a design was trained on them, and the words for pictures or exposures."""

Score = dict[str, dict[str, Any]]
"""Right answers by kind of scene: counts, and the share that is right with its 95 % interval."""


def score_of(scenes: Iterable[tuple[bool | None, int, int]]) -> Score:
    """Score of scenes, each with whether it was trained on, right answers and all answers."""
    answered = [scene for scene in scenes if scene[2]]
    score = {}
    for name, (kind, _) in _KINDS.items():
        of_kind = [(right, total) for trained, right, total in answered if trained is kind]
        right = sum(count for count, _ in of_kind)
        answers = sum(count for _, count in of_kind)
        share = right / answers if answers else None
        # exposures of one scene are alike: scenes are the trials
        low, high = (None, None) if share is None else wilson(share, len(of_kind))
        counts = {"right": right, "answers": answers, "scenes": len(of_kind)}
        score[name] = {**counts, "share": share, "low": low, "high": high}
    return score


def score_lines(score: Score, noun: str) -> list[str]:
    """Sentences on a score, new scenes first; the noun is a picture or an exposure."""
    line = "right: {right} of {answers} {0} ({share:.2f}, 95 % {low:.2f} to {high:.2f})"
    return [
        line.format(words.format(noun), **score[name])
        for name, (_, words) in _KINDS.items()
        if score[name]["answers"]
    ]
