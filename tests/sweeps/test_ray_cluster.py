"""Tasks on a real Ray cluster: here, several nodes on this machine.

Work functions are nested, so that they travel by value: workers do not see the test modules.
"""

import os
import socket
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import count
from pathlib import Path
from threading import Event

import numpy as np
import psutil
import pytest
import ray
from ray.cluster_utils import Cluster

from deepfsi import InputError, load_dataset
from deepfsi.sweeps import ray_cluster
from deepfsi.sweeps.plan import plan_trials
from deepfsi.sweeps.ray_cluster import answers, run_on_ray
from deepfsi.sweeps.recipe import Recipe
from deepfsi.sweeps.records import Records
from deepfsi.sweeps.workers import Resources
from shared.trials import train_trials
from shared.waiting import until

SEEN_SOON = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 500}
"""Ray settings under which the death of a node is noticed within seconds."""


@pytest.fixture(scope="module", autouse=True)
def no_token() -> Iterator[None]:
    """Keep Ray from reading or writing a token in the home folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_AUTH_MODE", "disabled")
        patch.delenv("RAY_ADDRESS", raising=False)
        yield


@pytest.fixture(scope="module")
def nodes(no_token: None) -> Iterator[Cluster]:
    """Give a cluster of one node with two CPUs, to which tests may add."""
    made = Cluster(True, head_node_args={"num_cpus": 2, "_system_config": SEEN_SOON})
    yield made
    ray.shutdown()
    made.shutdown()


@pytest.fixture
def connected(nodes: Cluster) -> str:
    """Give the address, to a process that stays connected: its tests share their workers."""
    if not ray.is_initialized():
        ray.init(nodes.address, log_to_driver=False, logging_level="error")
    return nodes.address


@pytest.fixture
def alone(nodes: Cluster) -> str:
    """Give the address, to a process that must connect."""
    ray.shutdown()
    return nodes.address


@pytest.mark.slow
def test_a_sweep_survives_the_death_of_a_node(nodes, connected, tmp_path):
    """A second node is killed at work; each record arrives once, as if it were made here."""
    recipe = Recipe(
        designs=("pca", "deepfsi"),
        photons=(1e3, 1e4),
        masks=(3, 6),
        trials=1,
        draws=1,
        training={"epochs": 4, "batch": 32},
    )
    digits = load_dataset("digits")
    trials = plan_trials(recipe, digits)
    second = nodes.add_node(num_cpus=2)
    raylet = psutil.Process(second.all_processes["raylet"][0].process.pid)
    killed_at_work, written = [], []
    over = Event()
    real = Records.write

    def kill_at_work() -> None:
        while not killed_at_work and not over.wait(0.01):
            with suppress(psutil.NoSuchProcess):
                killed_at_work.extend(c.name() for c in raylet.children() if "train" in c.name())
        if killed_at_work:
            nodes.remove_node(second, allow_graceful=False)

    def write(self, finished):
        written.extend(trial.key for trial, _, _ in finished)
        real(self, finished)

    with pytest.MonkeyPatch.context() as patch, ThreadPoolExecutor() as pool:
        patch.setattr(Records, "write", write)
        killed = pool.submit(kill_at_work)
        try:
            found = train_trials(
                trials, digits, tmp_path / "there", ray=connected, resources=Resources(cpus=2)
            )
        finally:
            over.set()
        killed.result()
    assert killed_at_work
    assert sorted(written) == sorted(trial.key for trial in trials)
    here = train_trials(trials, digits, tmp_path / "here")
    for one, other in zip(found, here, strict=True):
        assert one["key"] == other["key"]
        assert one["test"][0]["accuracy"] == pytest.approx(other["test"][0]["accuracy"], abs=0.02)


def free_address() -> str:
    """Address at which nothing answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return f"127.0.0.1:{server.getsockname()[1]}"


class Counted:
    """Counts how often it is packed."""

    packed = 0

    def __init__(self):
        self.array = np.arange(100_000.0)

    def __reduce__(self):
        Counted.packed += 1
        return np.asarray, (self.array,)


def test_every_result_arrives_once_and_shared_is_sent_once(connected):
    def work(shared: np.ndarray, task: int) -> tuple[float, bool]:
        return shared[task] * 2, shared.flags.owndata

    Counted.packed = 0
    results = list(run_on_ray(work, Counted(), range(30), address=connected))
    assert sorted(results) == [(2.0 * task, False) for task in range(30)]
    assert Counted.packed == 1


def test_few_tasks_are_in_flight(connected):
    submitted = count()

    class Task:
        def __reduce__(self):
            next(submitted)
            return int, ()

    results = run_on_ray(lambda _, task: task, None, [Task()] * 20, address=connected)
    next(results)
    assert next(submitted) == ray_cluster.TASKS_AHEAD * 2
    results.close()


def test_a_task_that_always_kills_its_worker_is_told(connected, tmp_path, monkeypatch):
    def work(folder: Path, task: int) -> int:
        if task == 1:
            with (folder / "deaths").open("a") as file:
                file.write("x")
            os.kill(os.getpid(), 9)
        return task

    monkeypatch.setattr(ray_cluster, "RETRIES", 1)
    with pytest.raises(InputError, match=r"a task was lost, and 1 retries .*WorkerCrashedError"):
        list(run_on_ray(work, tmp_path, range(3), address=connected))
    assert (tmp_path / "deaths").read_text() == "xx"


def test_what_work_raises_arrives_once_as_it_is(connected, tmp_path):
    def work(folder: Path, task: int) -> None:
        with (folder / "tries").open("a") as file:
            file.write("x")
        raise InputError("photons are 0: give more")

    with pytest.raises(InputError, match=r"^photons are 0: give more$") as raised:
        list(run_on_ray(work, tmp_path, [1], address=connected))
    assert type(raised.value) is InputError
    assert (tmp_path / "tries").read_text() == "x"


def test_stopping_early_cancels_the_rest(connected, tmp_path):
    def work(folder: Path, task: int) -> int:
        if task == 1:
            (folder / "part").write_text(str(os.getpid()))
            (folder / "part").rename(folder / "pid")
            time.sleep(600)
        while not (folder / "pid").exists():
            time.sleep(0.02)
        return task

    results = run_on_ray(work, tmp_path, [0, 1], address=connected)
    assert next(results) == 0
    pid = int((tmp_path / "pid").read_text())
    assert psutil.pid_exists(pid)
    results.close()
    until(lambda: not psutil.pid_exists(pid))


def test_workers_use_as_many_threads_as_they_have_cpus(connected):
    def work(_: None, task: int) -> str:
        return os.environ["OMP_NUM_THREADS"]

    assert list(run_on_ray(work, None, [0], address=connected, cpus=2)) == ["2"]
    assert list(run_on_ray(work, None, [0], address=connected, cpus=0.5)) == ["1"]


def test_what_no_node_has_is_refused(connected):
    with pytest.raises(ValueError, match="give whole GPUs, or a share of one"):
        Resources(gpus=1.5)
    with pytest.raises(InputError, match=r"no node .* 3 CPUs and 0 GPUs"):
        next(run_on_ray(max, 0, [0], address=connected, cpus=3))
    with pytest.raises(InputError, match=r"no node .* 1 CPUs and 0.5 GPUs"):
        next(run_on_ray(max, 0, [0], address=connected, gpus=0.5))


@pytest.mark.parametrize("form", ["{}", "ray://{}", "nonsense"])
@pytest.mark.usefixtures("alone")
def test_no_cluster_at_the_address(form):
    address = form.format(free_address())
    with pytest.raises(InputError, match=f"no Ray cluster answers at '{address}'"):
        next(run_on_ray(max, 0, [0], address=address))


@pytest.fixture
def address_there() -> Callable[[None, int], str]:
    def work(_: None, task: int) -> str:
        import ray

        return ray.get_runtime_context().gcs_address

    return work


@pytest.mark.slow
@pytest.mark.usefixtures("alone")
def test_local_starts_a_cluster_and_stops_it(nodes, address_there):
    [address] = run_on_ray(address_there, None, [0], address="local")
    assert address != nodes.address
    assert not ray.is_initialized()
    until(lambda: not answers(address))


def test_without_ray_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match="pip install ray"):
        next(run_on_ray(max, 0, [0]))
