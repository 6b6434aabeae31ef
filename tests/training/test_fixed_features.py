"""Features of fixed masks in a step of training: those of the formula, in few passes."""

from collections import Counter

import pytest
from torch.profiler import ProfilerActivity, profile

from deepfsi.exposure.training import JobGroup, build_training
from deepfsi.exposure.training_set import TrainingSet
from deepfsi.physics.training_noise import Draws
from shared.jobs import job

BATCH, MASKS = 50, 8
PASSES = {"aten::add", "aten::add_", "aten::sub", "aten::mul", "aten::div", "aten::addcmul"}
"""Operations that pass over all features of a step."""


@pytest.mark.parametrize("seeds", [[0], [0, 1]])
def test_a_step_passes_over_its_features_twice(digits, seeds):
    """Noise times its deviation, and the sum: features are standardised before the first step."""
    training_set = TrainingSet(digits, "cpu")
    jobs = [job(design="random", masks=MASKS, photons=1e3, seed=seed) for seed in seeds]
    group = JobGroup.of(training_set, jobs)
    training = build_training(group)
    training.prepare()
    draws = Draws(seeds, group.noise, training_set.labels, BATCH)
    draws.shuffle()
    draws.gather(0)
    with profile(activities=[ProfilerActivity.CPU]) as seen:
        training.inputs(draws)
    counted = Counter(event.name for event in seen.events())
    assert sum(counted[name] for name in PASSES) == 2 * len(seeds)
