"""Trials that are done, as files that any process may read, and locks on those that are not.

A folder holds

    trials/KEY.json           one record: settings, validation and test results
    designs/KEY.safetensors   the design itself; KEY is of what its training depends on
    locks/KEY.lock           locked while a process trains the design
    checkpoints/KEY.checkpoint
                             state of a training under way, of the first of its designs: of
                             whoever has the lock, removed with the last of them
    finished-KEY/            files of trials that were trained together, before they are moved

KEY is a hash of everything that the result depends on, the data included, so a record is valid for
whoever finds it. What was trained together is written all or not at all: a trial whose companions
are kept would be trained alone, and a sum of numbers in another order rounds otherwise.
"""

import json
import os
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from filelock import FileLock, Timeout

from deepfsi.base.errors import InputError
from deepfsi.base.files import new_folder, read_regular, write_atomically
from deepfsi.base.interrupts import note_saved_work
from deepfsi.sweeps.plan import Trial
from deepfsi.sweeps.results import RESULTS_SCHEMA

if TYPE_CHECKING:
    from deepfsi.design.design import Design

Record = dict[str, Any]
"""Results of a trial as its file holds them: JSON types only."""

_TRIALS_KEPT = "finished trials are kept, run again to go on"
"""Words of a stopped command, once a trial is finished."""


class FinishedTrial(NamedTuple):
    """A trial that was trained, tested, or both."""

    trial: Trial
    record: Record | None  # None where the training diverged
    design: bytes | None  # its design file


class Records:
    """The records of a folder, which is made if need be."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._locks: dict[str, FileLock] = {}
        # Each lock is an open file, and the usual limit of these is low
        if sys.platform != "win32":
            import resource

            soft, most = resource.getrlimit(resource.RLIMIT_NOFILE)
            # Where macOS names no limit, it allows 10240
            wanted = max(soft, 10240) if most == resource.RLIM_INFINITY else most
            with suppress(OSError, ValueError):
                resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))
        for lock in _files(folder / "locks"):  # of processes that are gone
            if self._take(lock.stem):
                self._give_up(lock.stem)
        # A process was killed before it moved them
        for finished in folder.glob("finished-*"):
            self._move(finished)
        self._clear_checkpoints()

    @property
    def checkpoints(self) -> Path:
        """Folder of the states of trainings under way."""
        return self.folder / "checkpoints"

    def read(self, trial: Trial) -> Record | None:
        """Record of a trial, or None if it or its design is missing, damaged or of other schema."""
        if not self._design_path(trial).is_file():
            return None
        try:
            content = read_regular(self._record_path(trial), 2**26, "leave it out")
            record = json.loads(content)
            named = record["schema"], record["key"], bool(record["test"][0]["terms"])
        except (ValueError, LookupError, TypeError, RecursionError):  # damaged
            return None
        if named != (RESULTS_SCHEMA, trial.key, True):
            return None
        note_saved_work(_TRIALS_KEPT)
        return record

    def design(self, trial: Trial) -> "Design | None":
        """Design of a trial that was trained already, perhaps for other tests."""
        from deepfsi.design.design import Design

        training = trial.job.training
        # A design file alone runs no code of a user's classifier
        code = training.classifier if training.is_custom else None
        try:
            return Design.load(self._design_path(trial), classifier=code)
        except InputError:
            return None

    def write(self, finished: Sequence[FinishedTrial]) -> None:
        """Keep the results of trials that were trained together, and release their locks.

        Diverged trials have no results; their locks are released, too.
        """
        self.release(done.trial for done in finished if done.record is None)
        finished = [done for done in finished if done.record is not None]
        if not finished:
            return
        folder = self.folder / f"finished-{finished[0].trial.key}"
        with new_folder(folder) as draft:
            for trial, record, design in finished:
                if design is not None:
                    write_atomically(draft / self._design_path(trial).name, design)
                record_file = draft / self._record_path(trial).name
                write_atomically(record_file, json.dumps(record, indent=1).encode())
        note_saved_work(_TRIALS_KEPT)  # the next process moves what this one does not
        self._move(folder)
        self._clear_checkpoints()
        self.release(done.trial for done in finished)

    def _move(self, finished: Path) -> None:
        """Move finished files to their places, each record after its design."""
        # A record says that its design is there, so that it comes last whenever this is killed
        for name, suffix in (("designs", ".safetensors"), ("trials", ".json")):
            (self.folder / name).mkdir(exist_ok=True)
            for path in (file for file in _files(finished) if file.suffix == suffix):
                with suppress(FileNotFoundError):  # another process that found them moved it
                    os.replace(path, self.folder / name / path.name)
        with suppress(OSError):
            finished.rmdir()

    def _clear_checkpoints(self) -> None:
        """Remove the checkpoints of finished designs, and their folder with the last."""
        for path in _files(self.checkpoints):
            if (self.folder / "designs" / f"{path.stem}.safetensors").is_file():
                path.unlink(missing_ok=True)
        with suppress(OSError):
            self.checkpoints.rmdir()

    def lock(self, trials: Iterable[Trial]) -> bool:
        """Claim trials for this process, all or none; False where another one has any of them."""
        taken: list[Trial] = []
        for trial in trials:
            if not self._take(trial.design_key):
                self.release(taken)
                return False
            taken.append(trial)
        return True

    def release(self, trials: Iterable[Trial]) -> None:
        """Give up locks. A process that dies gives up its own."""
        for trial in trials:
            self._give_up(trial.design_key)

    def release_all(self) -> None:
        """Give up every lock of this process."""
        for key in list(self._locks):
            self._give_up(key)

    def _take(self, key: str) -> bool:
        """Lock a design; False where it is locked, here or elsewhere."""
        path = self.folder / "locks" / f"{key}.lock"
        lock = FileLock(path, blocking=False, thread_local=False)
        try:
            lock.acquire()
        except (Timeout, FileNotFoundError, FileExistsError):  # another takes the folder away
            return False
        self._locks[key] = lock
        return True

    def _give_up(self, key: str) -> None:
        lock = self._locks.pop(key)
        path = Path(lock.lock_file)
        # Removed under the lock: once it is released another process may hold the file
        with suppress(OSError):  # Windows removes no open file
            path.unlink()
        lock.release()
        with suppress(OSError):  # others are locked
            path.parent.rmdir()

    def _record_path(self, trial: Trial) -> Path:
        return self.folder / "trials" / f"{trial.key}.json"

    def _design_path(self, trial: Trial) -> Path:
        return self.folder / "designs" / f"{trial.design_key}.safetensors"


def _files(folder: Path) -> list[Path]:
    """Paths in a folder; none where another process took it away."""
    try:
        return list(folder.iterdir())
    except FileNotFoundError:
        return []
