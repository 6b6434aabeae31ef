"""One line for what a user gives in Python."""

from functools import partial

import pytest

import deepfsi
from deepfsi import InputError


class Pairs:
    """A data set of torch."""


LEARN = partial(deepfsi.learn, "digits", masks=2, training={"epochs": 1})


@pytest.mark.parametrize(
    ("make", "fields", "said"),
    [
        (deepfsi.Training, {"classifier": None}, "classifier = None: give mlp, or"),
        (deepfsi.Camera, {"light": "sun"}, "light = 'sun'"),
        (LEARN, {"photons": True}, "budget True is not allowed.* such as 1e4"),
        (LEARN, {"counts": True}, "True counts are not allowed"),
        (LEARN, {"photons": (1e3, 1e4)}, "is no number.*exposure=Range"),
        (deepfsi.load_dataset, {"source": Pairs()}, "given as Pairs: give a Dataset.*two such"),
    ],
)
def test_a_setting_that_cannot_be_is_one_line(make, fields, said):
    with pytest.raises(InputError, match=said) as error:
        make(**fields)
    assert "\n" not in str(error.value)
