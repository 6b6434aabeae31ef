"""Exposures: which kind settings ask for, what each refuses, and what files of each are damaged."""

import shutil

import pytest

from conftest import synthetic
from deepfsi.base.errors import InputError
from deepfsi.jobs.exposures import find_exposure
from golden.file_cases import FOLDER
from shared.design_files import refused, rewrite
from shared.jobs import job, learn


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"spam": 3}, "no setting 'spam': did you mean 'span'"),
        ({"bins": 4, "span": 2.0}, "bins = 4: there is no such setting"),
        ({"bins": 2.5}, "bins = 2.5: give a whole number"),
        ({"span": 0.5}, "span = 0.5: give more than 1"),
    ],
    ids=str,
)
def test_what_is_no_exposure_is_refused(settings, match):
    with pytest.raises(InputError, match=match):
        find_exposure(settings)


DMD, PAPER, TWO_ARMS = {"camera": "dmd"}, {"camera": "paper"}, {"camera": "two-arm"}
RANGE, PATCH = {"span": 10.0}, {"patch": 4, "classifier": "vit"}
PASSING = {"bins": 6}


@pytest.mark.parametrize(
    ("settings", "faults"),
    [
        (DMD, []),
        (DMD | RANGE, []),
        (DMD | RANGE | {"dark": 30.0}, ["leave out camera noise, or train under ml_g"]),
        (DMD | RANGE | {"design": "control"}, ["leave out control, whose masks learn"]),
        (PAPER | PATCH, []),
        (DMD | PATCH, ["give the light law column"]),
        (PAPER | PATCH | {"train_noise": "poisson"}, ["trained under photon noise"]),
        (DMD | PASSING, []),
        (DMD | PASSING | {"masks": 5}, ["5 masks and 6 bins are one number"]),
        (TWO_ARMS | PASSING, ["give single rails"]),
        (DMD | PASSING | {"detectors": "2x2"}, ["no `detectors`"]),
    ],
    ids=str,
)
def test_every_fault_of_an_exposure_is_told(settings, faults):
    one = job(**{"masks": 6, "photons": 1e3, **settings})
    found = list(one.exposure.faults(one))
    assert len(found) == len(faults), found
    for told, words in zip(found, faults, strict=True):
        assert words in told


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"patch": 3, "masks": 9}, "cannot be cut in patches of 3x3"),
        ({"classifier_arguments": {"breadth": 3}}, "whole numbers of width, depth, heads, hidden"),
        ({"patch": 0, "classifier": "mlp", "camera": "dmd", "bins": 40, "speed": 2.0,
          "pattern_width": 9, "masks": 40}, "give fewer `bins`"),
    ],
)  # fmt: skip
def test_what_scenes_or_a_network_do_not_fit_is_refused(settings, match):
    given = {**PAPER, **PATCH, "masks": 16, "photons": 1e4, **settings}
    with pytest.raises(InputError, match=match):
        learn(synthetic((16, 8)), **{name: each for name, each in given.items() if each != 0})


def test_a_pattern_that_is_not_that_of_the_masks_is_refused(tmp_path):
    path = shutil.copy(FOLDER / "passing.safetensors", tmp_path)

    def inverted(header, tensors):
        tensors["exposure.pattern"] = 1 - tensors["exposure.pattern"]

    rewrite(path, inverted)
    refused(path)
