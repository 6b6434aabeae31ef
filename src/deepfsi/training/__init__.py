"""Learn masks and classifier together, several designs side by side."""

from deepfsi.training.assembly import design_of
from deepfsi.training.characterisation import find_temperatures
from deepfsi.training.checkpoint import NO_CHECKPOINT, Checkpoint
from deepfsi.training.hooks import Epoch
from deepfsi.training.learning import (
    Diverged,
    check_fits,
    companions,
    footprint,
    learn,
    memory_for,
    train,
)
from deepfsi.training.loop import batch_of
from deepfsi.training.readouts import SPLIT_WORDS, learn_readouts, measure_readouts

__all__ = [
    "NO_CHECKPOINT",
    "SPLIT_WORDS",
    "Checkpoint",
    "Diverged",
    "Epoch",
    "batch_of",
    "check_fits",
    "companions",
    "design_of",
    "find_temperatures",
    "footprint",
    "learn",
    "learn_readouts",
    "measure_readouts",
    "memory_for",
    "train",
]
