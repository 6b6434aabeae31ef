"""Checkpoints: the state of a training in a file, from which it resumes to the same bits.

A file holds the loops of one training in order: usually one, two for a control group, one more for
each fold. For a finished loop it keeps networks, masks and generators; for the running loop, all
that its steps change.
"""

import hashlib
import io
import json
import os
import time
import warnings
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from deepfsi.base.arrays import LARGEST_TENSORS
from deepfsi.base.errors import InputError
from deepfsi.base.files import read_regular, write_atomically
from deepfsi.base.interrupts import note_saved_work
from deepfsi.base.registry import UNNAMED_PLUGIN, source_hash
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.job import REVISION, Job, custom_parts
from deepfsi.physics.training_noise import Draws
from deepfsi.training.losses import CountsCost

CHECKPOINT_SECONDS = 120.0
"""Seconds between two writes."""

DIGEST = 32
"""Bytes of the SHA-256 at the start of a file, of the rest of it."""


@dataclass
class LoopState:
    """All that the steps of a loop change."""

    modules: Sequence[nn.Module]
    optimiser: torch.optim.Optimizer
    schedule: torch.optim.lr_scheduler.LRScheduler
    draws: Draws
    generators: Sequence[torch.Generator]  # in addition to the draws' generators
    total: int  # number of steps
    cost: CountsCost | None = None
    step: int = 0  # steps done

    def __post_init__(self) -> None:
        self.generators = [*(stream.generator for stream in self.draws.streams), *self.generators]

    def learned(self) -> list[Tensor]:
        """Current parameters and buffers of the modules."""
        return [
            tensor.detach()
            for module in self.modules
            for tensor in (*module.parameters(), *module.buffers())
        ]

    def state(self) -> dict[str, Any]:
        """State of a loop after its first step or later: tensors, numbers and text."""
        state = {
            "step": self.step,
            "learned": self.learned(),
            "generators": [generator.get_state() for generator in self.generators],
            "cost": None if self.cost is None else self.cost.weight,
        }
        if self.step < self.total:
            # drawn at the start of the running epoch, before the generators' present state
            state["orders"] = [stream.order for stream in self.draws.streams]
            state["optimiser"] = self.optimiser.state_dict()
            state["schedule"] = self.schedule.state_dict()
        return state

    def restore(self, state: dict[str, Any]) -> None:
        """Return the loop to a state."""
        self.step = state["step"]
        for tensor, stored in zip(self.learned(), state["learned"], strict=True):
            tensor.copy_(stored)
        for generator, stored in zip(self.generators, state["generators"], strict=True):
            generator.set_state(stored)
        if self.cost is not None:
            self.cost.restore(self.step, state["cost"])
        if "orders" not in state:  # the loop ended there
            self.total = self.step
            return
        for stream, order in zip(self.draws.streams, state["orders"], strict=True):
            stream.set_order(order)
        self.optimiser.load_state_dict(state["optimiser"])
        self.schedule.load_state_dict(state["schedule"])


class Checkpoint:
    """File for the state of a training while it runs; without a path it keeps nothing."""

    def __init__(self, path: Path | None = None, key: str = "", title: str = "") -> None:
        self.path = path
        self.key = key
        self.title = title
        self.seconds = 0.0
        self.words = f"{path} holds the training so far, from which it can be resumed"
        self._loops: list[dict[str, Any]] = []  # finished in this run
        self._before: list[dict[str, Any]] = []  # read from the file
        self._began = self._written = time.monotonic()

    @classmethod
    def of(
        cls,
        path: str | os.PathLike[str] | None,
        training_set: TrainingSet,
        jobs: Sequence[Job],
        matrix: np.ndarray | None = None,
    ) -> "Checkpoint":
        """Checkpoint of jobs that train together; an existing file is read."""
        if path is None:
            return cls()
        job = jobs[0]
        name = training_set.data.name
        title = f"{job.design}, {job.masks} masks, {job.photons:g} photons on {name}"
        checkpoint = cls(Path(path), _key(training_set, jobs, matrix), title)
        if os.path.lexists(path):
            checkpoint._read()
        return checkpoint

    def _read(self) -> None:
        """Read the file; `InputError` if it is damaged or of another training."""
        assert self.path is not None
        advice = "give the path of a checkpoint, or of a new file"
        content = read_regular(self.path, LARGEST_TENSORS, advice)
        file = io.BytesIO(content[DIGEST:])
        try:
            unpacked = sum(entry.file_size for entry in zipfile.ZipFile(file).infolist())
            changed = content[:DIGEST] != hashlib.sha256(content[DIGEST:]).digest()
            if changed or unpacked > len(content):  # torch compresses nothing
                raise ValueError
            file.seek(0)
            stored = torch.load(file, map_location="cpu", weights_only=True)
            key, title = stored["key"], stored["title"]
            self.seconds, self._before = stored["seconds"], stored["loops"]
        except Exception:  # torch raises almost anything on a damaged file
            again = "remove it, and the training begins anew"
            raise InputError(f"{self.path} is damaged: {again}") from None
        if key != self.key:
            raise InputError(
                f"{self.path} is of another training ({title}; other settings, data, torch or "
                "device): resume that one, or remove the file to begin anew"
            )

    @contextmanager
    def of_loop(self, loop: LoopState) -> Iterator[None]:
        """Restore a loop from the file, and let `keep` store it."""
        if self.path is None:
            yield
            return
        number = len(self._loops)
        if number < len(self._before):
            loop.restore(self._before[number])
        yield
        self._loops.append(loop.state())

    def keep(self, loop: LoopState) -> None:
        """Write the state of a loop after a step if it is time."""
        if self.path is not None and time.monotonic() - self._written >= CHECKPOINT_SECONDS:
            self._write(loop)

    def _write(self, loop: LoopState) -> None:
        assert self.path is not None
        # torch.save keeps the layout of tensors in memory, on which the last bits of a step depend
        stored = {
            "key": self.key,  # hash of everything that the bits depend on
            "title": self.title,
            "seconds": self.seconds + time.monotonic() - self._began,
            "loops": [*self._loops, loop.state()],
        }
        file = io.BytesIO()
        torch.save(stored, file)
        content = file.getvalue()
        try:
            write_atomically(self.path, hashlib.sha256(content).digest() + content)
        except InputError as error:  # the next write may have room again
            warnings.warn(f"{error}; the training goes on", stacklevel=2)
        else:
            note_saved_work(self.words)
        self._written = time.monotonic()

    def remove(self) -> None:
        """Remove the file of a finished training."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


NO_CHECKPOINT = Checkpoint()
"""Keeps nothing."""


def _key(training_set: TrainingSet, jobs: Sequence[Job], matrix: np.ndarray | None) -> str:
    """Hash of everything that the bits of a training depend on."""
    names = custom_parts(jobs[0])
    if UNNAMED_PLUGIN in names:
        raise InputError(
            "a part of your own that has no import path cannot be told from another when a "
            "training is resumed: give it as module:name, or leave out `checkpoint`"
        )
    settings = {
        "revision": REVISION,
        "jobs": [job.model_dump(mode="json") for job in jobs],
        "sources": [source_hash(name) for name in names],
        "data": (training_set.data.hash, training_set.data.held_out),
        "matrix": None if matrix is None else np.asarray(matrix, np.float32).tolist(),
        "torch": torch.__version__,
        "device": training_set.device.type,
    }
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()
