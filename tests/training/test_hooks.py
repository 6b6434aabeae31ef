"""What a user adds to the loop: epochs are told without moving a bit, and may end a training."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import RECIPE, same
from deepfsi import evaluate
from deepfsi import learn as learned
from deepfsi.base.errors import InputError
from deepfsi.training import losses
from shared.checkpoints import TRAININGS
from shared.jobs import learn
from shared.values import placed_digits

SHORT = {**RECIPE, "epochs": 3, "batch": 64, "photons": 1e3, "masks": 5, "device": "cpu"}


@pytest.fixture(scope="module")
def held(digits):
    few = replace(digits, x_train=digits.x_train[:500], y_train=digits.y_train[:500])
    return few.hold_out(120)


@pytest.fixture
def few(digits):
    return replace(digits, x_train=digits.x_train[:100], y_train=digits.y_train[:100])


@pytest.mark.parametrize("case", [name for name in TRAININGS if name != "a budget of counts"])
@pytest.mark.usefixtures("uncharacterised")
def test_no_bit_of_a_training_depends_on_who_looks_on(held, case):
    """Held-out scenes are answered after each epoch, as the design answers them at the end."""
    changes = TRAININGS[case]
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


def test_a_callback_ends_a_training_and_those_of_its_folds(few):
    settings = {**SHORT, "batch": 32}
    epochs = []
    ended = learn(few, callback=lambda each: epochs.append(each) or each.epoch == 1, **settings)
    assert [each.epoch for each in epochs] == [1]
    whole = learn(few, **settings)
    assert not same(ended, whole)
    assert ended.info["left_out"] != whole.info["left_out"]


@pytest.mark.usefixtures("uncharacterised")
def test_patience_keeps_the_weights_of_the_best_epoch(held):
    settings = {**SHORT, "epochs": 30, "lr": 0.3, "mask_lr": 0.3, "dropout": 0.1}
    patient = learn(held, patience=2, **settings)
    losses = [each["validation_loss"] for each in patient.info["history"]]
    best = int(np.argmin(losses)) + 1
    assert len(losses) == best + 2 < 30
    assert same(patient, learn(held, callback=lambda each: each.epoch == best, **settings))


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


@pytest.mark.usefixtures("uncharacterised")
def test_masks_start_from_a_matrix_or_a_design(held):
    still = {"photons": 1e3, "device": "cpu", "camera": "paper"}
    training = {**{n: RECIPE[n] for n in ("epochs", "lr", "hidden")}, "mask_lr": 1e-9}
    first = learned(held, masks=5, training={**training, "mask_lr": 0.1, "epochs": 3}, **still)
    varies = (held.x_train != held.x_train[0]).any(axis=0)
    for start in (first, first.matrix, 3 * first.matrix.astype(np.float64)):
        made = learned(held, start=start, training=training, **still)
        assert made.matrix[:, varies] == pytest.approx(first.matrix[:, varies], abs=1e-5)
        assert len(made.info["start"]) == 64
    assert "start" not in first.info


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"patience": 2}, r"digits has none: give `data.hold_out\(\)`"),
        ({"optimiser": torch.optim.SGD, "checkpoint": "state"}, "with optimiser is not resumed"),
        ({"callback": print, "design": "adaptive", "camera": "dmd"}, "leave callback"),
        ({"start": np.zeros((3, 5))}, r"of shape \(3, 5\) does not fit: give \(3, 64\)"),
        ({"start": np.ones((3, 64)), "design": "pca"}, "masks of pca do not learn"),
    ],
)
def test_what_cannot_be_is_refused(digits, given, words):
    with pytest.raises(InputError, match=words):
        learned(digits, **{"masks": 3, "photons": 1e3, **given})


def test_a_loss_of_ones_own_that_is_the_usual_one_trains_the_same_design():
    data, name = placed_digits(), "deepfsi.training.losses:squared_error"

    def made(**loss):
        training = {"epochs": 2, **loss}
        return learned(data, camera="dmd", photons=1e4, masks=4, training=training)

    usual, own, named = made(), made(loss=losses.squared_error), made(loss=name)
    assert torch.equal(usual.rails.stacked, own.rails.stacked)
    assert torch.equal(usual.rails.stacked, named.rails.stacked)
    assert own.info["job"]["training"]["loss"] == name
    other = made(loss=lambda outputs, truth: (outputs - truth).abs().mean(dim=-1))
    assert not torch.equal(usual.rails.stacked, other.rails.stacked)
    assert evaluate(other, data, 1e4, draws=1)[0].r2 > 0.3


@pytest.mark.parametrize(
    ("loss", "told"),
    [
        (lambda outputs, truth: outputs.mean(), r"gives \(\) of"),
        (lambda outputs, truth: outputs.detach()[:, 0], "no gradient"),
        ("no.such:loss", "cannot be imported"),
    ],
)
def test_a_bad_loss_is_refused_in_one_line(digits, loss, told):
    with pytest.raises(InputError, match=told) as error:
        learned(digits, camera="dmd", photons=1e4, masks=2, training={"epochs": 1, "loss": loss})
    assert "\n" not in str(error.value)
