"""Tasks in processes of their own on this machine, each with its share of the cores."""

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import ModuleType
from typing import Any, NamedTuple

from pydantic import Field, field_validator

from deepfsi.base.errors import InputError
from deepfsi.base.interrupts import block_ctrl_c, saved_work_text
from deepfsi.base.models import StrictModel
from deepfsi.base.progress import SILENT, Progress

LOOK_SECONDS = 0.5
"""Time between two looks at how far the tasks are."""

_shared: Any = None
_shares: Any = None
_slot = 0


class Resources(StrictModel):
    """Share of a cluster that each batch takes."""

    cpus: float = Field(1, gt=0, allow_inf_nan=False, description="processors")
    gpus: float = Field(0, ge=0, allow_inf_nan=False, description="GPUs, or a share of one")

    @field_validator("gpus")
    @classmethod
    def _whole(cls, gpus: float) -> float:
        if gpus > 1 and gpus % 1:
            raise ValueError(f"{gpus:g} is not allowed: give whole GPUs, or a share of one")
        return gpus


class _Running(NamedTuple):
    """Place of a task among all, and of `shares` where its process says how far it is."""

    place: int
    slot: int


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processes(
    work: Callable[[Any, Any], Any],
    shared: Any,
    tasks: Iterable[Any],
    workers: int,
    watch: Callable[[dict[int, float]], None] = lambda shares: None,
) -> Generator[Any, None, None]:
    """Results of tasks as they finish, each done by one of several processes."""
    others = set(multiprocessing.active_children())
    spawn = multiprocessing.get_context("spawn")
    shares = spawn.RawArray("d", workers)
    pool = ProcessPoolExecutor(
        workers,
        mp_context=spawn,
        initializer=_settle,
        initargs=(shared, shares, max(1, cores() // workers)),
    )
    resource_tracker.ensure_running()  # which would let Ctrl-C through, were it started later
    waiting = enumerate(tasks)
    free = list(range(workers))  # places of `shares`
    running: dict[Future[Any], _Running] = {}
    try:
        while True:
            while free and (next_task := next(waiting, None)):
                slot = free.pop()
                shares[slot] = 0.0
                with block_ctrl_c(), _main_hidden():
                    index, task = next_task
                    running[pool.submit(_run, work, task, slot)] = _Running(index, slot)
            if not running:
                return
            done, _ = wait(running, LOOK_SECONDS, return_when=FIRST_COMPLETED)
            watch({now.place: shares[now.slot] for now in running.values()})
            free += [running.pop(future).slot for future in done]
            yield from [future.result() for future in done if not future.exception()]
            for future in done:
                future.result()
    except BrokenProcessPool:
        raise InputError(
            f"one of {workers} worker processes was killed, perhaps for want of memory: run again "
            f"with fewer `workers`{saved_work_text()}"
        ) from None
    finally:
        if running:
            for child in set(multiprocessing.active_children()) - others:
                child.terminate()
        pool.shutdown(cancel_futures=True)


@contextmanager
def _main_hidden() -> Iterator[None]:
    """Start processes that do not run the caller's script again, which may have no main guard."""
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


def report_of_task() -> Progress:
    """Report of the task that this worker process does; of any other process one that is silent."""
    if _shares is None:
        return SILENT

    def show(share: float, _: str) -> None:
        _shares[_slot] = share

    return Progress(show)


def _settle(shared: Any, shares: Any, threads: int) -> None:
    """Prepare a process: Ctrl-C is its parent's to handle, and it dies with its parent."""
    import torch
    from threadpoolctl import threadpool_limits

    global _shared, _shares
    _shared = shared
    _shares = shares
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(threads)
    threadpool_limits(threads)
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _run(work: Callable[[Any, Any], Any], task: Any, slot: int) -> Any:
    global _slot
    _slot = slot
    return work(_shared, task)
