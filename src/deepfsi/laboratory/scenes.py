"""Scenes of a run: pictures that a display shows, or a list of names."""

from pathlib import Path

from deepfsi.datasets import read_display
from deepfsi.datasets.display import Display
from deepfsi.design.training_data import trained_on
from deepfsi.errors import InputError
from deepfsi.hardware.patterns.folder import DESIGN, read_patterns
from deepfsi.hardware.recording.acquisition import Scene
from deepfsi.hardware.recording.scene_list import read_scenes
from deepfsi.laboratory.rails import ShownDesign


def displayed(source: Path, patterns: Path) -> Display:
    """Pictures of scenes, with the white of the patterns' design where their type has none."""
    images = read_display(source)
    if not images.levels.chosen or read_patterns(patterns).manifest.design_sha256 is None:
        return images
    known = trained_on(ShownDesign.read(patterns / DESIGN).header.info)
    white = known.origin.white if known and known.origin else None
    return images if white is None else read_display(source, white)


def scenes_of(images: Display) -> tuple[Scene, ...]:
    """Scenes by the names of their pictures, with the classes of the folders."""
    labels = images.labels or [None] * len(images.names)
    return tuple(Scene(name=n, label=x) for n, x in zip(images.names, labels, strict=True))


def listed(source: Path) -> tuple[Scene, ...]:
    """Scenes of a list, of one picture or of a folder of pictures."""
    suffix = source.suffix.lower()
    if suffix in (".txt", ".csv") and not source.exists():
        raise InputError(f"there is nothing at {source}: give a list of scenes, or their pictures")
    if source.is_file() and suffix in ("", ".txt", ".csv"):
        return read_scenes(source)
    return scenes_of(read_display(source))
