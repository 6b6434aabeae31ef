"""Checkpoints: the state of a training in a file, from which it resumes to the same bits.

A file holds the loops of one training in order: usually one, two for a control group, one more for
each fold. For a finished loop it keeps networks, masks and generators; for the running loop, all
that its steps change.
"""

import hashlib
import json
import os
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.numpy import save as to_bytes
from torch import Tensor, nn

from deepfsi.base.arrays import read_tensors
from deepfsi.base.errors import InputError
from deepfsi.base.files import write_atomically
from deepfsi.base.interrupts import note_saved_work
from deepfsi.base.registry import UNNAMED_PLUGIN, source_hash
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.jobs.job import REVISION, Job, custom_parts
from deepfsi.physics.training_noise import Draws
from deepfsi.training.losses import CountsCost

CHECKPOINT_SECONDS = 120.0
"""Seconds between two writes."""

HEADER = "deepfsi-checkpoint"
"""Key of the header among the metadata of the file."""

Arrays = dict[str, np.ndarray]
"""State by name."""


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

    def learned(self) -> dict[str, Tensor]:
        """Current parameters and buffers of the modules."""
        return {
            f"module.{place}.{name}": tensor.detach()
            for place, module in enumerate(self.modules)
            for name, tensor in (*module.named_parameters(), *module.named_buffers())
        }

    def arrays(self) -> Arrays:
        """State of a loop after its first step or later."""
        tensors = self.learned()
        for index, generator in enumerate(self.generators):
            tensors[f"generator.{index}"] = generator.get_state()
        if self.cost is not None:
            tensors["cost"] = self.cost.weight
        if self.step < self.total:
            for place, stream in enumerate(self.draws.streams):
                tensors[f"rows.{place}"] = stream.order
            for number, moments in self.optimiser.state_dict()["state"].items():
                tensors |= {
                    f"optimiser.{number}.{name}": tensor for name, tensor in moments.items()
                }
        return {name: _array(tensor) for name, tensor in tensors.items()}

    def restore(self, step: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Return the loop to a step and its state."""
        if "rows.0" not in arrays:  # the loop ended there
            self.total = step
        for name, tensor in self.learned().items():
            tensor.copy_(_tensor(arrays[name], tensor))
        for index, generator in enumerate(self.generators):
            generator.set_state(torch.from_numpy(arrays[f"generator.{index}"]))
        if self.cost is not None:
            self.cost.restore(step, torch.from_numpy(arrays["cost"]))
        if step < self.total:
            for index, stream in enumerate(self.draws.streams):
                stream.follow(torch.from_numpy(arrays[f"rows.{index}"]))
        learning = [weight for group in self.optimiser.param_groups for weight in group["params"]]
        moments: dict[int, dict[str, Tensor]] = {}
        for name, array in arrays.items():
            if name.startswith("optimiser."):
                _, place, part = name.split(".")
                count = torch.from_numpy(array)
                tensor = count if part == "step" else _tensor(array, learning[int(place)])
                moments.setdefault(int(place), {})[part] = tensor
        groups = self.optimiser.state_dict()["param_groups"]
        self.optimiser.load_state_dict({"state": moments, "param_groups": groups})
        # the learning rate follows from the step alone
        before = {"last_epoch": step - 1, "_step_count": step + 1}
        self.schedule.load_state_dict({**self.schedule.state_dict(), **before})
        self.schedule.step()
        self.step = step


class Checkpoint:
    """File for the state of a training while it runs; without a path it keeps nothing."""

    def __init__(self, path: Path | None = None, key: str = "", title: str = "") -> None:
        self.path = path
        self.key = key
        self.title = title
        self.seconds = 0.0
        self.words = f"{path} holds the training so far, from which it can be resumed"
        self._loops: list[tuple[int, Arrays]] = []  # finished in this run
        self._before: list[tuple[int, Arrays]] = []  # read from the file
        self._began = self._written = time.monotonic()

    @classmethod
    def of(
        cls,
        path: str | os.PathLike[str] | None,
        training_set: TrainingSet,
        jobs: Sequence[Job],
        matrix: np.ndarray | None = None,
        counts: float | None = None,
    ) -> "Checkpoint":
        """Checkpoint of jobs that train together; an existing file is read."""
        if path is None:
            return cls()
        job = jobs[0]
        name = training_set.data.name
        title = f"{job.design}, {job.masks} masks, {job.photons:g} photons on {name}"
        checkpoint = cls(Path(path), _key(training_set, jobs, matrix, counts), title)
        if os.path.lexists(path):
            checkpoint._read()
        return checkpoint

    def _read(self) -> None:
        """Read the file; `InputError` if it is damaged or of another training."""
        assert self.path is not None
        advice = "give the path of a checkpoint, or of a new file"
        try:
            text, arrays = read_tensors(self.path, HEADER, advice)
            header = json.loads(text)
            if header["content"] != _content(arrays):
                raise self._damaged()
            key, title, steps = header["key"], header["title"], header["steps"]
            self.seconds = header["seconds"]
        except InputError:
            raise
        except (ValueError, KeyError, TypeError) as error:
            raise self._damaged() from error
        if key != self.key:
            raise InputError(
                f"{self.path} is of another training ({title}; other settings, data, torch "
                "or device): resume that one, or remove the file to begin anew"
            )
        self._before = [
            (step, {name.partition("/")[2]: array for name, array in arrays.items()
                    if name.startswith(f"{place}/")})
            for place, step in enumerate(steps)
        ]  # fmt: skip

    def _damaged(self) -> InputError:
        return InputError(f"{self.path} is damaged: remove it, and the training begins anew")

    @contextmanager
    def of_loop(self, loop: LoopState) -> Iterator[None]:
        """Restore a loop from the file, and let `keep` store it."""
        if self.path is None:
            yield
            return
        place = len(self._loops)
        if place < len(self._before):
            try:
                loop.restore(*self._before[place])
            except (KeyError, IndexError, TypeError, ValueError, RuntimeError) as error:
                raise self._damaged() from error
        yield
        self._loops.append((loop.step, loop.arrays()))

    def keep(self, loop: LoopState) -> None:
        """Write the state of a loop after a step if it is time."""
        if self.path is not None and time.monotonic() - self._written >= CHECKPOINT_SECONDS:
            self._write(loop)

    def _write(self, loop: LoopState) -> None:
        assert self.path is not None
        loops = [*self._loops, (loop.step, loop.arrays())]
        arrays = {
            f"{place}/{name}": array
            for place, (_, state) in enumerate(loops)
            for name, array in state.items()
        }
        header = {
            "key": self.key,  # hash of everything that the bits depend on
            "title": self.title,
            "steps": [step for step, _ in loops],  # done in each loop
            "seconds": self.seconds + time.monotonic() - self._began,
            "content": _content(arrays),
        }
        try:
            write_atomically(self.path, to_bytes(arrays, {HEADER: json.dumps(header)}))
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


def _key(
    training_set: TrainingSet,
    jobs: Sequence[Job],
    matrix: np.ndarray | None,
    counts: float | None,
) -> str:
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
        "matrix": None if matrix is None else _content({"matrix": np.asarray(matrix, np.float32)}),
        "counts": counts,
        "torch": torch.__version__,
        "device": training_set.device.type,
    }
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def _content(arrays: Mapping[str, np.ndarray]) -> str:
    """SHA-256 in hex over arrays, their names, types and shapes."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(f"{name} {array.dtype} {array.shape};".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _array(tensor: Tensor) -> np.ndarray:
    """Copy of a tensor in NumPy; bfloat16 becomes the integers of its bits."""
    whole = tensor.detach().to("cpu", copy=True).contiguous()
    return (whole.view(torch.int16) if whole.dtype == torch.bfloat16 else whole).numpy()


def _tensor(array: np.ndarray, like: Tensor) -> Tensor:
    """Tensor of an array, laid out in memory like another."""
    tensor = torch.from_numpy(array)
    tensor = tensor.view(torch.bfloat16) if like.dtype == torch.bfloat16 else tensor
    if (tensor.shape, tensor.dtype) != (like.shape, like.dtype):
        raise ValueError(f"{tuple(tensor.shape)} {tensor.dtype}, not {tuple(like.shape)}")
    return torch.empty_like(like).copy_(tensor)
