"""Settings of an exposure: which kind they ask for, what each refuses, and what it changes."""

import pytest
from pydantic import BaseModel

from deepfsi import Fixed, Looks, Nested, Passing, Patches, Range
from deepfsi.base import InputError
from deepfsi.jobs import find_exposure
from deepfsi.jobs.exposures import AnyExposure
from shared.jobs import job

KINDS = [
    ({}, Fixed()),
    ({"span": 10.0}, Range(span=10.0)),
    ({"nested": 3}, Nested(nested=3)),
    ({"nested": 3, "span": 10.0}, Nested(nested=3, span=10.0)),
    ({"looks": 4}, Looks(looks=4)),
    ({"patch": 8}, Patches(patch=8)),
    ({"bins": 6, "jitter": 2.0}, Passing(bins=6, jitter=2.0)),
]


@pytest.mark.parametrize(("settings", "wanted"), KINDS, ids=str)
def test_settings_ask_for_a_kind_and_come_back_from_json(settings, wanted):
    found = find_exposure(settings)
    assert found == wanted
    assert type(found) is type(wanted)
    assert find_exposure(found) is found
    assert find_exposure(found.model_dump(mode="json")) == found

    class Holder(BaseModel):
        exposure: AnyExposure

    held = Holder(exposure=settings)
    assert Holder.model_validate_json(held.model_dump_json()).exposure == wanted


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"look": 3}, "an exposure has no setting 'look': did you mean 'looks'"),
        ({"bins": 4, "looks": 2}, "bins and looks are of different exposures: give one"),
        ({"looks": 4, "span": 10.0}, "span and looks are of different exposures: give one"),
        ({"looks": 4, "nested": 2}, "nested and looks are of different exposures: give one"),
        ({"looks": 4, "patch": 8}, "patch and looks are of different exposures: give one"),
        ({"patch": 8, "span": 2.0}, "span and patch are of different exposures: give one"),
        ({"looks": 0}, "looks = 0: give 2 or more"),
        ({"looks": 65}, "looks = 65: give 64 or less"),
        ({"looks": 2.5}, "looks = 2.5: give a whole number"),
        ({"nested": -1}, "nested = -1: give 1 or more"),
        ({"span": 0.5}, "span = 0.5: give more than 1"),
        ({"span": 1e13}, "span = .*give 1e.12 or less"),
        ({"patch": 1}, "patch = 1: give 2 or more"),
    ],
    ids=str,
)
def test_what_is_no_exposure_is_one_line(settings, match):
    with pytest.raises(InputError, match=match) as error:
        find_exposure(settings)
    assert "\n" not in str(error.value)


ONE_DMD = {"camera": "dmd"}


@pytest.mark.parametrize(
    ("settings", "faults"),
    [
        ({**ONE_DMD}, []),
        ({**ONE_DMD, "looks": 4}, []),
        ({**ONE_DMD, "looks": 4, "dark": 30.0}, []),
        ({**ONE_DMD, "looks": 4, "dark": 30.0, "sigma": 2.0}, []),
        ({"camera": "two-arm", "looks": 4}, []),
        ({"camera": "paper", "looks": 4}, ['`light="free-dwell"` or "two-arm" goes with them']),
        ({"light": "equal-dwell", "looks": 4}, ["not equal-dwell"]),
        ({**ONE_DMD, "rails": "dual", "looks": 4}, ['use `readout="both"`, or `rails="single"`']),
        ({**ONE_DMD, "looks": 4, "noise": "gaussian"}, ["leave gaussian noise out"]),
        ({**ONE_DMD, "looks": 4, "train_noise": "gaussian"}, ["leave gaussian noise out"]),
        ({**ONE_DMD, "looks": 4, "shortest_dwell": "0.3s"}, ["give fewer looks, or a longer"]),
        ({**ONE_DMD, "looks": 4, "design": "control"}, ["control has one look only"]),
        (
            {"camera": "paper", "looks": 4, "noise": "gaussian"},
            ["not column", "leave gaussian noise out"],
        ),
        ({**ONE_DMD, "span": 10.0}, []),
        ({**ONE_DMD, "span": 10.0, "dark": 30.0}, ["leave out camera noise, or train under ml_g"]),
        ({**ONE_DMD, "span": 10.0, "dark": 30.0, "train_noise": "ml_gauss"}, []),
        ({**ONE_DMD, "span": 10.0, "train_noise": "poisson"}, ["leave out poisson noise"]),
        ({**ONE_DMD, "nested": 3, "design": "control"}, ["leave out control, whose masks learn"]),
        ({**ONE_DMD, "nested": 6}, []),
        ({**ONE_DMD, "nested": 7}, ["the first 7 of 6 masks cannot be nested: give at most 6"]),
        (
            {**ONE_DMD, "nested": 7, "train_noise": "none"},
            ["leave out none noise", "give at most 6"],
        ),
        ({"camera": "paper", "patch": 4}, []),
        ({**ONE_DMD, "patch": 4}, ["give the light law column"]),
        ({"camera": "paper", "patch": 4, "levels": 2}, ["with continuous masks"]),
        ({"camera": "paper", "patch": 4, "design": "random"}, ["random is not for patches"]),
        ({"camera": "paper", "patch": 4, "classifier": "mlp"}, ["give classifier vit"]),
    ],
    ids=str,
)
def test_every_fault_of_an_exposure_is_told(settings, faults):
    one = job(masks=6, photons=1e3, **settings)
    found = list(one.exposure.faults(one))
    assert len(found) == len(faults), found
    for told, words in zip(found, faults, strict=True):
        assert words in told
        assert "\n" not in told
