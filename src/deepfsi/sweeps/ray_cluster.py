"""Many tasks on a Ray cluster: what is shared is sent once, results come back as they finish."""

import importlib.util
import logging
import os
import socket
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Any, TypeVar

from deepfsi.base import InputError, restore_handlers

Shared = TypeVar("Shared")
Task = TypeVar("Task")
Result = TypeVar("Result")

TASKS_AHEAD = 2
"""Tasks submitted for each that can run: the next one waits beside it, a growing cluster sees
demand, and a hundred thousand do not flood the driver."""

ANSWER_SECONDS = 5.0
"""Seconds in which a cluster must answer. Ray itself tries for minutes."""


def run_on_ray(
    work: Callable[[Shared, Task], Result],
    shared: Shared,
    tasks: Iterable[Task],
    *,
    address: str = "auto",
    cpus: float = 1,
    gpus: float = 0,
    retries: int = 3,
) -> Generator[tuple[int, Result], None, None]:
    """Index of each task and what `work(shared, task)` returned on a Ray cluster, as they finish.

    Stopping early cancels the rest, and stops a cluster that was started here. Where every node
    that could run a task has gone, it waits for one to come.
    """
    check_request(cpus, gpus)
    with _connected(address):
        submit = _submitter(work, shared, cpus, gpus, retries)
        yield from _results(submit, tasks, cpus, gpus, retries)


def check_request(cpus: float, gpus: float) -> None:
    """Raise `InputError` where Ray is missing or no task can ask for so much."""
    if importlib.util.find_spec("ray") is None:
        raise InputError("Ray is not installed: pip install ray")
    if cpus < 0 or gpus < 0 or cpus + gpus == 0 or (gpus > 1 and gpus % 1):
        raise InputError(
            f"a task cannot ask for {cpus:g} CPUs and {gpus:g} GPUs: give numbers ≥ 0, "
            "not both 0, and whole GPUs or a share of one"
        )


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


def _submitter(
    work: Callable[[Shared, Task], Result], shared: Shared, cpus: float, gpus: float, retries: int
) -> Callable[[Task], Any]:
    """Function that submits a task and gives Ray's reference to its result."""
    import ray

    if not _slots(cpus, gpus):
        raise InputError(
            f"no node of the cluster has the {cpus:g} CPUs and {gpus:g} GPUs that one task "
            f"asks for (there are: {_nodes()}): ask for less, or add a node that has them"
        )

    def run(shared: Shared, task: Task) -> Result:
        return work(shared, task)

    remote = ray.remote(run).options(
        name=getattr(work, "__name__", "work"),
        num_cpus=cpus,
        num_gpus=gpus,
        max_retries=retries,
        runtime_env={"env_vars": {"OMP_NUM_THREADS": str(max(1, int(cpus)))}},
    )
    everywhere = ray.put(shared)
    return lambda task: remote.remote(everywhere, task)


def _results(
    submit: Callable[[Task], Any], tasks: Iterable[Task], cpus: float, gpus: float, retries: int
) -> Generator[tuple[int, Any], None, None]:
    """Submit tasks as there is room, and yield index and result of each as they finish."""
    import ray

    running: dict[Any, int] = {}
    waiting = iter(enumerate(tasks))
    try:
        while True:
            room = max(1, TASKS_AHEAD * _slots(cpus, gpus)) - len(running)
            for index, task in islice(waiting, max(0, room)):
                running[submit(task)] = index
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


def _nodes() -> list[tuple[float, float]]:
    """CPUs and GPUs of each node."""
    import ray

    each = (node["Resources"] for node in ray.nodes() if node["Alive"])
    return [(has.get("CPU", 0.0), has.get("GPU", 0.0)) for has in each]


def _slots(cpus: float, gpus: float) -> int:
    """Tasks that can run at once."""
    return sum(
        int(min(has / need for has, need in zip(node, (cpus, gpus), strict=True) if need) + 1e-9)
        for node in _nodes()
    )
