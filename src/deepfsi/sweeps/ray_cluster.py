"""Many tasks on a Ray cluster: what is shared is sent once, results come back as they finish."""

import importlib.util
import logging
import os
import socket
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Any, TypeVar

from deepfsi.base.errors import InputError
from deepfsi.base.interrupts import restore_handlers

_Shared = TypeVar("_Shared")
_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

TASKS_AHEAD = 2
"""Tasks submitted for each that can run: the next one waits beside it, a growing cluster sees
demand, and a hundred thousand do not flood the driver."""

ANSWER_SECONDS = 5.0
"""Seconds in which a cluster must answer. Ray itself tries for minutes."""


def run_on_ray(
    work: Callable[[_Shared, _Task], _Result],
    shared: _Shared,
    tasks: Iterable[_Task],
    *,
    address: str = "auto",
    cpus: float = 1,
    gpus: float = 0,
    retries: int = 3,
) -> Generator[tuple[int, _Result], None, None]:
    """Do tasks on a Ray cluster, and give what they return as they finish.

    Stopping early cancels the rest, and stops a cluster that was started here. Where every node
    that could run a task has gone, it waits for one to come.
    """
    if importlib.util.find_spec("ray") is None:
        raise InputError("Ray is not installed: pip install ray")
    with _connected(address):
        yield from _results(work, shared, tasks, (cpus, gpus), retries=retries)


@contextmanager
def _connected(address: str) -> Iterator[None]:
    """Stay connected to a cluster, unless this process is connected to one already."""
    import ray

    joined = not ray.is_initialized()
    if joined:
        with restore_handlers():
            _join(address)
    try:
        yield
    finally:
        if joined:
            ray.shutdown()


def _results(
    work: Callable[[_Shared, _Task], _Result],
    shared: _Shared,
    tasks: Iterable[_Task],
    demand: tuple[float, float],
    *,
    retries: int,
) -> Generator[tuple[int, _Result], None, None]:
    """Submit tasks as there is room, and yield index and result of each as they finish."""
    import ray

    cpus, gpus = demand
    if not _slots(*demand):
        there = [(node.get("CPU", 0.0), node.get("GPU", 0.0)) for node in _nodes()]
        raise InputError(
            f"no node of the cluster has the {cpus:g} CPUs and {gpus:g} GPUs that one task asks "
            f"for (there are: {there}): ask for less, or add a node that has them"
        )

    def run(shared: _Shared, task: _Task) -> _Result:
        return work(shared, task)

    remote = ray.remote(run).options(
        name=getattr(work, "__name__", "work"),
        num_cpus=cpus,
        num_gpus=gpus,
        max_retries=retries,
        runtime_env={"env_vars": {"OMP_NUM_THREADS": str(max(1, int(cpus)))}},
    )
    everywhere = ray.put(shared)
    running: dict[Any, int] = {}
    waiting = iter(enumerate(tasks))
    try:
        while True:
            room = max(1, TASKS_AHEAD * _slots(*demand)) - len(running)
            for index, task in islice(waiting, max(0, room)):
                running[remote.remote(everywhere, task)] = index
            if not running:
                return
            [ready], _ = ray.wait(list(running), num_returns=1)
            index = running.pop(ready)
            try:
                result = ray.get(ready)
            except ray.exceptions.RayTaskError as error:
                raise error.cause from error
            except ray.exceptions.RayError as error:
                first = str(error).strip().split("\n")[0]
                raise InputError(
                    f"task {index} was lost and {retries} retries did not save it "
                    f"({type(error).__name__}: {first}): if nodes run out of memory, give each "
                    "task more CPUs, so that fewer share a node; Ray's logs on the node say more"
                ) from error
            yield index, result
    finally:
        for reference in running:
            ray.cancel(reference, force=True)


def _join(address: str) -> None:
    """Connect this process to a cluster, or start one."""
    import ray
    from ray._private.services import get_ray_address_from_environment

    where = address
    if address == "auto":
        try:
            where = get_ray_address_from_environment("auto", None)
        except ConnectionError:
            where = "local"
        if not os.environ.get("RAY_ADDRESS") and not answers(where):
            where = "local"  # a cluster that crashed leaves its address behind
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if where == "local":
        ray.init("local", include_dashboard=False, **quiet)
        return
    if not answers(where):
        raise InputError(
            f"no Ray cluster answers at '{where}': give host:port of a running one "
            "(ray start --head --port=6379), or 'local' to start one here"
        )
    try:
        ray.init(address, **quiet)  # "auto" as it is: then Ray finds its token, too
    except (OSError, RuntimeError, ValueError, ImportError, ray.exceptions.RayError) as error:
        first = str(error).strip().split("\n")[0]
        raise InputError(
            f"cannot join the Ray cluster at '{where}' ({first}): it needs this process's versions "
            "of Ray and Python, its token (RAY_AUTH_MODE=token), and this machine as a node"
        ) from error


def answers(address: str) -> bool:
    """True where something answers at an address, `host:port`."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), ANSWER_SECONDS).close()
    except (OSError, ValueError):
        return False
    return True


def _slots(cpus: float, gpus: float) -> int:
    """Tasks that can run at once on the cluster that this process is connected to."""
    needs = [(need, name) for need, name in ((cpus, "CPU"), (gpus, "GPU")) if need]
    return sum(
        int(min(node.get(name, 0.0) / need for need, name in needs) + 1e-9) for node in _nodes()
    )


def _nodes() -> list[dict[str, float]]:
    """Processors and GPUs of each node of the cluster."""
    import ray

    return [node["Resources"] for node in ray.nodes() if node["Alive"]]
