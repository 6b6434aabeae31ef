"""What a user adds to the loop: epochs are told without moving a bit, and may end a training."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import RECIPE, same
from deepfsi import evaluate
from deepfsi import learn as learned
from deepfsi.base import InputError
from shared.checkpoints import Stopped, write_each_step
from shared.jobs import learn

SHORT = {**RECIPE, "epochs": 3, "batch": 64, "photons": 1e3, "masks": 5, "device": "cpu"}


@pytest.fixture(scope="module")
def held(digits):
    """Scenes of which some are held out."""
    few = replace(digits, x_train=digits.x_train[:500], y_train=digits.y_train[:500])
    return few.hold_out(120)


CASES = {
    "learned masks": {"dropout": 0.1},
    "fixed masks": {"design": "random"},
    "counts that are drawn": {"noise": "poisson", "rails": "single", "light": "free-dwell"},
    "few counts": {"noise": "poisson", "counts": 50.0, "camera": "dmd"},
    "a range of budgets": {"span": 100.0},
    "nested masks": {"nested": 2, "light": "equal-dwell"},
    "looks": {"camera": "dmd", "looks": 2, "dropout": 0.1},
    "patches": {"patch": 4, "masks": 6, "classifier": "vit", "hidden": None},
    "passing scenes": {"camera": "dmd", "bins": 8, "masks": None},
    "a module of one's own": {"classifier": "shared.networks:Cnn", "hidden": None},
    "a noise of one's own": {"noise": "shared.noises:photons", "design": "pca"},
    "the control group": {"design": "control", "sigma": 3.0, "dropout": 0.1},
}


@pytest.mark.parametrize("changes", CASES.values(), ids=CASES)
@pytest.mark.usefixtures("uncharacterised")
def test_no_bit_of_a_training_depends_on_who_looks_on(held, changes):
    """Held-out scenes are answered after each epoch, as the design answers them at the end."""
    settings = {name: each for name, each in {**SHORT, **changes}.items() if each is not None}
    epochs = []
    alone = learn(held, **settings)
    watched = learn(held, callback=epochs.append, **settings)
    assert "history" not in alone.info
    history = watched.info.pop("history")
    alone.info["seconds"] = watched.info["seconds"] = 0.0
    assert watched.to_bytes() == alone.to_bytes()
    last = epochs[-1]
    assert [each["epoch"] for each in history] == [1, 2, 3]
    assert history[-1]["loss"] == last.loss
    if "span" not in changes and "shared" not in str(changes.get("noise")):
        [result] = evaluate(watched, held, 1e3, draws=1, seed=0)
        assert last.validation_accuracy == pytest.approx(result.accuracy, abs=1e-6)


def test_a_callback_ends_a_training_and_those_of_its_folds(digits):
    few = replace(digits, x_train=digits.x_train[:100], y_train=digits.y_train[:100])
    settings = {**SHORT, "batch": 32}
    epochs = []
    ended = learn(few, callback=lambda each: epochs.append(each) or each.epoch == 1, **settings)
    assert [each.epoch for each in epochs] == [1]
    whole = learn(few, **settings)
    assert not same(ended, whole)
    assert ended.info["left_out"] != whole.info["left_out"]


@pytest.mark.usefixtures("uncharacterised")
def test_patience_keeps_the_weights_of_the_best_epoch(held):
    """They are those of a training that ended there."""
    settings = {**SHORT, "epochs": 30, "lr": 0.3, "mask_lr": 0.3, "dropout": 0.1}
    patient = learn(held, patience=2, **settings)
    losses = [each["validation_loss"] for each in patient.info["history"]]
    best = int(np.argmin(losses)) + 1
    assert len(losses) == best + 2 < 30
    assert same(patient, learn(held, callback=lambda each: each.epoch == best, **settings))


@pytest.mark.usefixtures("uncharacterised")
def test_a_training_that_was_ended_is_resumed_to_the_same_end(digits, tmp_path, monkeypatch):
    """The folds that follow begin after it, not its next epoch."""
    few = replace(digits, x_train=digits.x_train[:100], y_train=digits.y_train[:100])
    settings = {**SHORT, "batch": 32, "checkpoint": tmp_path / "state"}
    numbers = []

    def once(epoch):
        numbers.append(epoch.epoch)
        return True

    whole = learn(few, callback=once, **settings)
    state = write_each_step(monkeypatch)
    state["last"] = 4  # the first step of the first fold
    with pytest.raises(Stopped):
        learn(few, callback=once, **settings)
    state["last"] = 0
    assert same(learn(few, callback=once, **settings), whole)
    assert numbers == [1, 1]


@pytest.mark.usefixtures("uncharacterised")
def test_optimiser_and_schedule_are_torchs(held):
    """Given as they are by default, they end in the same bits; others step otherwise."""

    def adamw(groups):
        assert [each["lr"] for each in groups] == [5e-3, 5e-3]  # classifier and masks
        return torch.optim.AdamW(groups, fused=True)

    def one_cycle(optimiser, steps):
        rates = [each["lr"] for each in optimiser.param_groups]
        return torch.optim.lr_scheduler.OneCycleLR(optimiser, rates, total_steps=steps)

    usual = learn(held, **SHORT)
    spelt = learn(held, optimiser=adamw, schedule=one_cycle, **SHORT)
    assert same(usual, spelt)
    assert spelt.info["optimiser"].endswith("adamw")
    epochs = []
    cosine = torch.optim.lr_scheduler.CosineAnnealingLR
    other = learn(held, optimiser=torch.optim.SGD, schedule=cosine, callback=epochs.append, **SHORT)
    assert not same(usual, other)
    assert (other.info["optimiser"], other.info["schedule"]) == ("SGD", "CosineAnnealingLR")
    assert 5e-3 > epochs[0].lr > epochs[1].lr > epochs[2].lr


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"callback": 3}, "callback = 3: give a function"),
        ({"patience": 0}, "patience = 0: give a whole number of epochs, 1 or more"),
        ({"patience": 2}, r"digits has none: give `data.hold_out\(\)`"),
        ({"optimiser": torch.optim.SGD, "checkpoint": "state"}, "with optimiser is not resumed"),
        ({"optimiser": lambda groups: None}, "optimiser gives None: give"),
        ({"schedule": lambda optimiser, steps: 3}, "schedule gives 3: give"),
        ({"callback": print, "design": "adaptive", "camera": "dmd"}, "by no steps: leave callback"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(digits, given, words):
    with pytest.raises(InputError, match=words) as error:
        learned(digits, **{"masks": 3, "photons": 1e3, **given})
    assert "\n" not in str(error.value)


@pytest.mark.usefixtures("uncharacterised")
class TestStarts:
    """Learned masks start from those of a design, or from a matrix."""

    def test_masks_start_from_a_matrix(self, held):
        still = {"masks": 5, "photons": 1e3, "device": "cpu", "camera": "paper"}
        training = {**{n: RECIPE[n] for n in ("epochs", "lr", "hidden")}, "mask_lr": 1e-9}
        first = learned(held, training={**training, "mask_lr": 0.1, "epochs": 3}, **still)
        varies = (held.x_train != held.x_train[0]).any(axis=0)
        still.pop("masks")
        for start in (first, first.matrix, 3 * first.matrix.astype(np.float64)):
            made = learned(held, start=start, training=training, **still)
            assert made.matrix[:, varies] == pytest.approx(first.matrix[:, varies], abs=1e-5)
            assert len(made.info["start"]) == 64
        assert "start" not in first.info

    @pytest.mark.parametrize(
        ("given", "words"),
        [
            ({"start": np.zeros((3, 5))}, r"of shape \(3, 5\) does not fit: give \(3, 64\)"),
            ({"start": np.zeros(64)}, "give a design, or finite numbers"),
            ({"start": "pca"}, "give a design, or finite numbers"),
            ({"start": np.full((3, 64), -1.0), "camera": "dmd"}, "negative entries: give 0"),
            ({"start": np.ones((3, 64)), "design": "pca"}, "masks of pca do not learn"),
            ({"start": np.ones((8, 64)), "exposure": {"bins": 8}}, "starts at random"),
        ],
    )
    def test_a_start_that_cannot_be_is_refused(self, digits, given, words):
        with pytest.raises(InputError, match=words):
            learned(digits, photons=1e3, **given)
