"""Trainings that are ended after one of their checkpoints."""

from pathlib import Path

from deepfsi.training import checkpoint


class Stopped(Exception):
    """What a kill is in these tests."""


def write_each_step(monkeypatch) -> dict[str, int]:
    """Write a checkpoint after each step; end the training after the one numbered `last`, from 1.

    The state that is returned counts those that were written.
    """
    monkeypatch.setattr(checkpoint, "CHECKPOINT_SECONDS", 0.0)
    state, write = {"count": 0, "last": 0}, checkpoint.write_atomically

    def written(path: Path, content: bytes) -> Path:
        write(path, content)
        state["count"] += 1
        if state["count"] == state["last"]:
            raise Stopped
        return path

    monkeypatch.setattr(checkpoint, "write_atomically", written)
    return state
