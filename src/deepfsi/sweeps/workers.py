"""Tasks in processes of their own on this machine, each with its share of the cores."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from deepfsi.errors import InputError
from deepfsi.interrupts import held_back

Task = TypeVar("Task")
Shared = TypeVar("Shared")
Result = TypeVar("Result")

_shared: Any = None


class Resources(BaseModel):
    """Share of a cluster that each batch takes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    cpus: float = Field(1, gt=0, allow_inf_nan=False)
    gpus: float = Field(0, ge=0, allow_inf_nan=False)


@dataclass(frozen=True)
class Workers:
    """Processes that train.

    Parameters
    ----------
    count : int, optional
        On this machine, each with its share of the cores; None for one a core, or one for a GPU.
        With more than one, a script of yours needs ``if __name__ == "__main__":``.
    ray : str, optional
        Address of a Ray cluster to work on instead, or "auto".
    resources : Resources
        Share of the cluster that each batch takes.
    """

    count: int | None = 1
    ray: str | None = None
    resources: Resources = field(default_factory=Resources)


HERE = Workers()
"""This process alone."""


def default_count(device: str) -> int:
    """Number of processes that are fastest on a device: on a processor one for each core."""
    return 1 if device == "cuda" else cores()


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processes(
    work: Callable[[Shared, Task], Result], shared: Shared, tasks: Iterable[Task], workers: int
) -> Generator[Result, None, None]:
    """Results of tasks as they finish.

    Parameters
    ----------
    work : callable
        Of a module, so that another process can import it.
    shared : object
        What every task needs; sent once to each process.
    tasks : iterable
        Taken one by one, when a process is about to become free.
    workers : int
        Processes, each with an equal share of the cores.

    Raises
    ------
    InputError
        If a process was killed, most likely for want of memory.
    Exception
        Whatever `work` raises. The other processes are then stopped.
    """
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_settle,
        initargs=(shared, max(1, cores() // workers)),
    )
    resource_tracker.ensure_running()  # which would let Ctrl-C through, were it started later
    queue = iter(tasks)
    running: set[Future[Result]] = set()
    try:
        while True:
            for task in queue:
                with held_back():
                    running.add(pool.submit(_run, work, task))
                if len(running) == workers:
                    break
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            yield from [future.result() for future in done if not future.exception()]
            for future in done:
                future.result()
    except BrokenProcessPool:
        raise InputError(
            f"one of {workers} worker processes was killed, perhaps for want of memory: finished "
            "work is kept; run again with fewer `workers`"
        ) from None
    finally:
        if running:
            for child in set(multiprocessing.active_children()) - others:
                child.terminate()
        pool.shutdown(cancel_futures=True)


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


def _run(work: Callable[[Any, Task], Result], task: Task) -> Result:
    return work(_shared, task)
