"""What a user adds to the loop: epochs are told without moving a bit, and may end a training."""

from dataclasses import replace

import pytest
import torch

from conftest import RECIPE, same
from deepfsi import InputError, evaluate
from deepfsi import learn as learned
from deepfsi.design.file import file_of
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


@pytest.mark.parametrize("case", TRAININGS)
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
    assert file_of(watched).to_bytes() == file_of(alone).to_bytes()
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


def test_a_callback_follows_steps_alone(digits):
    settings = {"masks": 3, "photons": 1e3, "design": "adaptive", "camera": "dmd"}
    with pytest.raises(InputError, match="leave callback out"):
        learned(digits, callback=print, **settings)


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
