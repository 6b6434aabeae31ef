"""Commands that are killed at random moments, again and again, lose and repeat nothing.

DEEPFSI_KILLS=50 pytest tests/sweeps/test_kills.py kills them more often.
"""

import json
import multiprocessing
import os
import random
import re
import shutil
import signal
import sys
import threading
import time
from functools import partial
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import psutil
import pytest
from safetensors.numpy import load_file

from deepfsi.cli import run_command_line
from deepfsi.datasets.display import write_pictures
from deepfsi.training import checkpoint
from shared.live_samples import make_patterns
from shared.trials import left_over, tensors
from shared.waiting import PATIENCE

KILLS = int(os.environ.get("DEEPFSI_KILLS", "2"))
RECIPE = """
designs = ["pca", "deepfsi"]
photons = [1e2, 1e3]
masks = {masks}
trials = {trials}
draws = 1
training = {{ epochs = 2, batch = {batch} }}
"""
MASKS = (1, 2, 3, 4)
FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(["torch._dynamo", "sklearn.datasets", "scipy.stats"])  # take seconds


def written(folder: Path) -> dict[Path, tuple[int, int]]:
    """Records with the moment and the inode of their writing."""
    states = {path: path.stat() for path in folder.glob("trials/*.json")}
    return {path: (state.st_mtime_ns, state.st_ino) for path, state in states.items()}


def records(folder: Path) -> dict[str, Any]:
    """Content of each record by the name of its file, but for the time that its training took."""
    contents = {path.name: json.loads(path.read_text()) for path in folder.glob("trials/*")}
    for record in contents.values():
        record["info"]["seconds"] = 0.0
    return contents


def sweep(
    tmp_path: Path, trials: int, workers: int, masks: tuple[int, ...] = MASKS, batch: int = 64
) -> list[str]:
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(RECIPE.format(trials=trials, masks=list(masks), batch=batch))
    return ["sweep", str(recipe), "--json", "-o", str(tmp_path / "out"), "--workers", str(workers)]


MOVES = ("os.rename",)
FILES = ("open", "os.mkdir", *MOVES, "os.rmdir", "os.remove")


def run(words: list[str], folder: Path, nth=0, delay=0.0, events=FILES) -> None:
    """Run a command line in a folder; kill it some time after the n-th event of a file there.

    What it says goes to the file `said`, and so does how many there were.
    """
    os.chdir(folder)
    for stream in (1, 2):
        os.dup2(os.open("said", os.O_WRONLY | os.O_CREAT), stream)
    home, left, kill = os.getcwd(), nth, partial(os.kill, os.getpid(), signal.SIGKILL)

    def count(event: str, values: tuple) -> None:
        nonlocal left
        if event in events and os.path.abspath(str(values[0])).startswith(home):
            left -= 1
            if left == 0:
                threading.Timer(delay, kill).start() if delay else kill()

    sys.addaudithook(count)
    checkpoint.CHECKPOINT_SECONDS = 0.0
    sys.argv = ["deepfsi", *words]
    try:
        run_command_line()
    finally:
        print("files", -left, flush=True)


def start(words: list[str], folder: Path, *rest: float) -> BaseProcess:
    process = FORKS.Process(target=run, args=(words, folder, *rest))
    process.start()
    return process


def ended(words: list[str], folder: Path, *rest: float) -> int:
    process = start(words, folder, *rest)
    process.join()
    return process.exitcode


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_random_kills_lose_no_record_and_repeat_none(done, tmp_path):
    """One process, or one with two workers, which die with it; a record is never written twice."""
    trials = max(2, KILLS)
    chance = random.Random(1)
    kept: dict[Path, tuple[int, int]] = {}
    for kill in range(KILLS):
        process = start(sweep(tmp_path, trials, workers=1 + kill % 2), tmp_path)
        while kill % 5 and written(tmp_path / "out") == kept:  # else it may be killed at its start
            assert process.is_alive(), "the sweep ended before it was killed"
            time.sleep(0.005)
        time.sleep(chance.uniform(0, 0.5))
        assert process.is_alive(), "the sweep ended before it was killed: give it more trials"
        workers = psutil.Process(process.pid).children(recursive=True)
        assert workers or not (kill % 2 and kill % 5)
        process.kill()
        process.join()
        assert not psutil.wait_procs(workers, timeout=PATIENCE)[1]
        now = written(tmp_path / "out")
        assert {path: now.get(path) for path in kept} == kept
        for path in now.keys() - kept.keys():
            assert json.loads(path.read_text())["test"]
        kept = now
    text = done(*sweep(tmp_path, trials, workers=1))
    now = written(tmp_path / "out")
    assert {path: now.get(path) for path in kept} == kept
    assert len(now) == 2 * 2 * len(MASKS) * trials
    assert sum(point["trials"] for point in json.loads(text)["points"]) == len(now)
    # a later run removes drafts of a killed process after a day
    assert not [path for path in left_over(tmp_path / "out") if ".draft" not in str(path)]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_kill_while_files_are_written_leaves_nothing_and_changes_no_bit(done, tmp_path):
    """Before the record is moved into its place; the design is in its own.

    Trials that were trained together are kept together: alone one of them rounds otherwise.
    """
    settings = {"trials": 1, "workers": 1, "masks": (1, 2), "batch": 500}
    recipe = sweep(tmp_path, **settings)
    assert ended(recipe, tmp_path, 12, 0.0, MOVES) == -signal.SIGKILL
    assert tensors(tmp_path / "out")
    assert not written(tmp_path / "out")
    done(*recipe)
    assert not left_over(tmp_path / "out")
    assert len(written(tmp_path / "out")) == 2 * 2 * 2
    whole = tmp_path / "whole"
    whole.mkdir()
    done(*sweep(whole, **settings))
    for content in (tensors, records):
        assert content(tmp_path / "out") == content(whole / "out")


COMMANDS = {
    "design": "design --photons 1e4 --masks 3 --epochs 1 --hidden 8 -o out.safetensors",
    "export": "dmd export hadamard --size 8x8 --dmd 64x48 -o out",
    "import": "camera import run/photons.ptu --patterns scan --scenes scenes -o out",
    "live": "camera live patterns --scene scenes --flux 1e7 --exposure 10ms -o out",
}


@pytest.fixture(scope="module")
def lab(tmp_path_factory, digits):
    """Scenes, a scan and its run, and patterns of adaptive masks."""
    lab = tmp_path_factory.mktemp("lab")
    make_patterns(lab, digits, photons=1e5)
    write_pictures({f"{k}.png": digits.x_test[k].reshape(8, 8) for k in range(9)}, lab / "scenes")
    light = ["--scene", "scenes", "--flux", "1e6", "--exposure", "10ms", "-o", "run"]
    for words in (["dmd", "export", "hadamard", "--size", "8x8", "--dmd", "64x48", "-o", "scan"],
                  ["camera", "simulate", "scan", *light]):  # fmt: skip
        assert not ended(words, lab)
    return lab


def results(lab: Path, log: str = "") -> dict[str, Any]:
    """What a command wrote under its final name; of a live run, its finished scenes."""
    if log:
        lines = (lab / log).read_text().splitlines(keepends=True) if (lab / log).exists() else []
        scenes = [json.loads(line) for line in lines if line.endswith("\n")]
        return {str(k): {**scene, "clock_s": 0} for k, scene in enumerate(scenes)}
    if (design := lab / "out.safetensors").exists():
        return {name: tensor.tobytes() for name, tensor in load_file(design).items()}
    files = [path for path in lab.glob("out/**/*") if path.is_file()]
    return {str(path.relative_to(lab)): path.read_bytes() for path in files}


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_what_random_kills_leave_is_whole_and_the_command_goes_on(command, lab, tmp_path, done):
    """A live run goes on in another folder, and its finished scenes are classified."""
    chance = random.Random(1)
    log = "out/shown.jsonl" if command == "live" else ""

    words = COMMANDS[command].split()
    shutil.copytree(lab, tmp_path / "whole")
    assert not ended(words, tmp_path / "whole")
    files = int(re.findall(r"files (\d+)", (tmp_path / "whole/said").read_text())[0])
    whole = results(tmp_path / "whole", log)
    assert whole
    killed = shutil.copytree(lab, tmp_path / "killed")
    for _ in range(KILLS):
        moment = chance.randint(1, files), chance.choice((0, chance.uniform(0, 0.1)))
        assert ended(words, killed, *moment) in (0, -signal.SIGKILL)
        kept = results(killed, log)
        assert kept == ({key: whole[key] for key in kept} if log else kept and whole)
        if log and kept:
            told = done("camera", "classify", killed / "patterns", killed / "out", "--json")
            assert len(json.loads(told)["scenes"]) == len(kept)
        if kept or log:  # else it goes on with what was left
            shutil.rmtree(killed / "out", ignore_errors=True)
            (killed / "out.safetensors").unlink(missing_ok=True)
    assert not ended(words, killed)
    assert results(killed, log) == whole
