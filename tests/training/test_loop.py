"""Training repeats, and treats replicas as if alone."""

import os
import subprocess
import sys
from dataclasses import replace

import pytest
import torch

from conftest import OPTICS, RECIPE, quick, same
from deepfsi import Design
from deepfsi.design.networks import Replicas
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.training import loop
from deepfsi.training.learning import train
from shared.jobs import job as job_of

pytestmark = pytest.mark.usefixtures("trained_once")

LONGER = {**RECIPE, "epochs": 10, "dropout": 0.1}


@pytest.fixture(scope="module")
def few(digits):
    """So few digits that no tail of theirs is calibrated, which takes longer than to train."""
    return replace(digits, x_train=digits.x_train[:400], y_train=digits.y_train[:400])


@pytest.fixture(scope="module")
def varies(few):
    return torch.from_numpy(few.x_train.std(axis=0) > 0.01)


def test_the_global_random_state_does_not_matter(digits):
    torch.manual_seed(1)
    first = quick(digits, dropout=0.1)
    torch.manual_seed(2)
    assert same(first, quick(digits, dropout=0.1))


def apart(first: Design, second: Design, pixels: torch.Tensor) -> float:
    """Largest difference over its peak, of masks at some pixels, std and classifier.

    Not of the mean, which takes up whatever masks do where pixels do not vary.
    """
    masks = [each.rails.stacked[..., pixels] for each in (first, second)]
    pairs = [masks, (first.exposure.std, second.exposure.std)]
    pairs += zip(first.classifier.parameters(), second.classifier.parameters(), strict=True)
    return max(((a - b).abs().max() / b.abs().max()).item() for a, b in pairs)


@pytest.mark.usefixtures("uncharacterised")
@pytest.mark.parametrize(
    ("design", "noise", "tight", "light", "rails"),
    [
        *(("deepfsi", "ml_gauss", 1e-3, *optics) for optics in OPTICS),
        ("pca", "ml_gauss", 1e-5, "free-dwell", "single"),
        ("pca", "poisson", 1e-6, "two-arm", "dual"),
        ("random", "ml_gauss", 1e-5, "column", "dual"),
        ("control", "ml_gauss", 1e-2, "column", "dual"),
    ],
)
def test_replicas_train_together_as_alone(few, varies, design, light, rails, noise, tight):
    """Up to float32 rounding, after 40 steps; learned masks where a pixel varies.

    Masks that learn draw other counts: where rounding moves a rate, all draws after it may differ.
    """
    settings = {**LONGER, "design": design, "light": light, "rails": rails, "noise": noise}
    jobs = [job_of(masks=6, photons=photons, **settings) for photons in (1e3, 1e6)]
    training_set = TrainingSet(few, "cpu")
    pixels = varies if design in ("deepfsi", "control") else torch.arange(64)
    for one, job in zip(train(training_set, jobs), jobs, strict=True):
        [alone] = train(training_set, [job])
        assert apart(one, alone, pixels) <= tight
        assert one.info["job"] == alone.info["job"]


@pytest.mark.usefixtures("uncharacterised")
@pytest.mark.parametrize(
    ("design", "change", "seeds"),
    [
        ("pca", {"noise": "poisson"}, (3, 3, 4)),
        ("random", {}, (3, 4, 7)),
        ("deepfsi", {"light": "two-arm"}, (3, 4, 7)),
        ("deepfsi", {"noise": "gaussian", "sigma": 3.0}, (3, 3, 4)),
        ("control", {}, (3, 4, 7)),
        ("pca", {"span": 100.0}, (3, 3, 4)),
    ],
)
def test_seeds_train_together_as_alone(few, varies, monkeypatch, design, change, seeds):
    """With their weights stacked, as on a GPU, or not; alone they are not."""
    change = {**LONGER, "start": "random", **change}
    jobs = [
        job_of(design=design, masks=6, photons=photons, seed=seed, **change)
        for seed, photons in zip(seeds, (1e3, 1e5, 1e3), strict=True)
    ]
    training_set = TrainingSet(few, "cpu")
    alone = [train(training_set, [job])[0] for job in jobs]
    tight = 1e-2 if design == "control" else 1e-3
    for stacks in (False, True):
        monkeypatch.setattr(loop, "Replicas", lambda nets, stacked, s=stacks: Replicas(nets, s))
        together = train(training_set, jobs)
        for one, other in zip(together, alone, strict=True):
            assert apart(one, other, varies) <= tight
        assert apart(together[0], together[2], varies) > 0.01


@pytest.mark.skipif(sys.platform != "linux", reason="asks GNU OpenMP, which torch has on Linux")
def test_threads_wait_asleep(monkeypatch):
    """Threads that spin beside busy programs cost several times the work itself."""
    for name in ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT"):
        monkeypatch.delenv(name, raising=False)
    command, asked = [sys.executable, "-c", "import deepfsi, torch"], {"OMP_DISPLAY_ENV": "verbose"}
    said = subprocess.run(
        command, env={**os.environ, **asked}, check=True, capture_output=True, text=True
    ).stderr
    assert "GOMP_SPINCOUNT = '0'" in said
