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
from itertools import islice
from multiprocessing import resource_tracker
from types import ModuleType
from typing import Any

from pydantic import Field, field_validator

from deepfsi.base.errors import InputError
from deepfsi.base.interrupts import block_ctrl_c, saved_work_text
from deepfsi.base.models import StrictModel

_shared: Any = None
"""What all tasks of this process share."""


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


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processes(
    work: Callable[[Any, Any], Any], shared: Any, tasks: Iterable[Any], workers: int
) -> Generator[Any, None, None]:
    """Results of tasks in the order in which processes finish them."""
    strangers = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        workers,
        # A fork would copy locks that threads of torch may hold
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_settle,
        initargs=(shared, max(1, cores() // workers)),
    )
    resource_tracker.ensure_running()  # started later it would let Ctrl-C through
    waiting = iter(tasks)
    running: set[Future[Any]] = set()
    try:
        while True:
            for task in islice(waiting, workers - len(running)):
                with block_ctrl_c(), _main_hidden():
                    running.add(pool.submit(_run, work, task))
            if not running:
                return
            done, running = wait(running, 1.0, FIRST_COMPLETED)  # Windows hears Ctrl-C between
            yield from [future.result() for future in done if not future.exception()]
            # Errors come after the results that are ready
            for future in done:
                future.result()
    except BrokenProcessPool:
        raise InputError(
            f"one of {workers} worker processes was killed, perhaps for want of memory: run again "
            f"with fewer `workers`{saved_work_text()}"
        ) from None
    finally:
        if running:
            for child in set(multiprocessing.active_children()) - strangers:
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


def _settle(shared: Any, threads: int) -> None:
    """Prepare a process: Ctrl-C is its parent's to handle, and it dies with its parent."""
    import torch
    from threadpoolctl import threadpool_limits

    global _shared
    _shared = shared
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(threads)
    threadpool_limits(threads)
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _run(work: Callable[[Any, Any], Any], task: Any) -> Any:
    return work(_shared, task)
