"""Many tasks on a Ray cluster: what is shared is sent once, results come back as they finish."""

import logging
import signal
import socket
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Any

from deepfsi.base.errors import InputError

TASKS_AHEAD = 2
"""Tasks submitted for each that can run: the next one waits beside it, a growing cluster sees
demand, and a hundred thousand do not flood the driver."""

RETRIES = 3
"""Times that a task is done again whose node was lost."""


def run_on_ray(
    work: Callable[[Any, Any], Any],
    shared: Any,
    tasks: Iterable[Any],
    *,
    address: str = "auto",
    cpus: float = 1,
    gpus: float = 0,
) -> Generator[Any, None, None]:
    """Yield what tasks return on a Ray cluster, as each finishes.

    Stopping early cancels the rest, and stops a cluster that was started here. Where every node
    that could run a task has gone, it waits for one to come.
    """
    try:
        import ray
    except ImportError:
        raise InputError("Ray is not installed: pip install ray") from None

    with _connected(address):
        if not _slots(cpus, gpus):
            raise InputError(
                f"no node of the cluster has the {cpus:g} CPUs and {gpus:g} GPUs that one task "
                "asks for: ask for less, or add a node that has them"
            )
        remote = ray.remote(work).options(
            num_cpus=cpus,
            num_gpus=gpus,
            max_retries=RETRIES,
            runtime_env={"env_vars": {"OMP_NUM_THREADS": str(max(1, int(cpus)))}},
        )
        reference = ray.put(shared)
        running: list[Any] = []
        waiting = iter(tasks)
        try:
            while True:
                room = max(1, TASKS_AHEAD * _slots(cpus, gpus)) - len(running)
                running += [
                    remote.remote(reference, task) for task in islice(waiting, max(0, room))
                ]
                if not running:
                    return
                [ready], running = ray.wait(running, num_returns=1)
                yield _result(ready)
        finally:
            for task in running:
                ray.cancel(task, force=True)


def _result(ready: Any) -> Any:
    """Result of a task, or the error of its work."""
    import ray

    try:
        return ray.get(ready)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from error
    except ray.exceptions.RayError as error:
        raise InputError(
            f"a task was lost, and {RETRIES} retries did not save it ({type(error).__name__}, see "
            "Ray's logs): give each task more CPUs, so that fewer share a node's memory"
        ) from error


@contextmanager
def _connected(address: str) -> Iterator[None]:
    """Stay connected to a cluster, unless this process is connected to one already."""
    import ray

    if ray.is_initialized():
        yield
        return
    usual = signal.getsignal(signal.SIGTERM)
    try:
        _join(address)
        if usual is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, usual)  # Ray replaced it
        yield
    finally:
        ray.shutdown()


def _join(address: str) -> None:
    """Connect this process to a cluster, or start one."""
    import ray

    advice = (
        "give host:port of a running one (ray start --head --port=6379), or 'local' to start one "
        "here"
    )
    if address not in ("auto", "local") and not answers(address):
        raise InputError(f"no Ray cluster answers at '{address}': {advice}")
    try:
        ray.init(address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, RuntimeError, ValueError, ImportError, ray.exceptions.RayError) as error:
        raise InputError(
            f"cannot join the Ray cluster at '{address}' ({str(error).strip().splitlines()[0]}): "
            f"it needs the same Ray and Python, its token (RAY_AUTH_MODE=token), and a node here; "
            f"{advice}"
        ) from error


def answers(address: str) -> bool:
    """True where something answers at an address, `host:port`, within 5 s; Ray tries minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), 5.0).close()
    except (OSError, ValueError):
        return False
    return True


def _slots(cpus: float, gpus: float) -> int:
    """Tasks that can run at once on the cluster that this process is connected to."""
    import ray

    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    needs = [(need, name) for need, name in ((cpus, "CPU"), (gpus, "GPU")) if need]
    # 1e-9: rounding of shares such as 0.1 must not cost a task
    return sum(
        int(min(node.get(name, 0.0) / need for need, name in needs) + 1e-9) for node in nodes
    )
