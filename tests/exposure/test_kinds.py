"""Exposures: which kind settings ask for, what each refuses, and what files of each are damaged."""

import shutil

import pytest

from conftest import synthetic
from deepfsi import Fixed, Job, Range
from deepfsi.base.errors import InputError
from deepfsi.jobs.exposures import find_exposure
from deepfsi_flow.settings import Passing
from deepfsi_paper.patches.settings import Patches
from golden.file_cases import FOLDER
from shared.design_files import refused, rewrite
from shared.jobs import job, learn

KINDS = [
    ({}, Fixed()),
    ({"span": 10.0}, Range(span=10.0)),
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
    asked = Job(masks=6, photons=1e3, exposure=settings)
    assert Job.model_validate_json(asked.model_dump_json()).exposure == wanted


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"spam": 3}, "no setting 'spam': did you mean 'span'"),
        ({"bins": 4, "span": 2.0}, "bins and span are of different exposures"),
        ({"patch": 8, "span": 2.0}, "patch and span are of different exposures"),
        ({"bins": 2.5}, "bins = 2.5: give a whole number"),
        ({"span": 0.5}, "span = 0.5: give more than 1"),
        ({"span": 1e13}, "span = .*give 1e.12 or less"),
        ({"patch": 1}, "patch = 1: give 2 or more"),
        ({"bins": 1}, "bins = 1: give 2 or more"),
        ({"speed": 0}, "speed = 0: give more than 0"),
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
        (DMD | RANGE | {"dark": 30.0, "train_noise": "ml_gauss"}, []),
        (DMD | RANGE | {"train_noise": "poisson"}, ["leave out poisson noise"]),
        (DMD | RANGE | {"train_noise": "none"}, ["leave out none noise"]),
        (DMD | RANGE | {"design": "control"}, ["leave out control, whose masks learn"]),
        (PAPER | PATCH, []),
        (DMD | PATCH, ["give the light law column"]),
        (PAPER | PATCH | {"levels": 2}, ["with continuous masks"]),
        (PAPER | PATCH | {"train_noise": "poisson"}, ["trained under photon noise"]),
        (PAPER | PATCH | {"design": "random"}, ["random is not for patches"]),
        (PAPER | PATCH | {"design": "control"}, ["control is not for patches"]),
        (DMD | PASSING, []),
        (DMD | PASSING | {"design": "pca"}, ["pca is a set of masks"]),
        (DMD | PASSING | {"masks": 5}, ["5 masks and 6 bins are one number"]),
        (DMD | PASSING | {"start": "pca"}, ["starts at random"]),
        (TWO_ARMS | PASSING, ["give single rails"]),
        (PAPER | PASSING, ["give single rails"]),
        (DMD | PASSING | {"detectors": "2x2"}, ["no `detectors`"]),
        (DMD | PASSING | {"device": "dlp7000"}, ["no `device`"]),
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
        ({"hidden": (8,)}, "are of the usual classifier"),
        ({"patch": 0}, "vit reads features of patches, and the exposure"),
        ({"classifier": "mlp"}, "mlp reads features of whole scenes"),
        ({"patch": 3, "masks": 9}, "cannot be cut in patches of 3x3"),
        ({"classifier_arguments": {"breadth": 3}}, "whole numbers of width, depth, heads, hidden"),
        ({"classifier_arguments": {"width": 0}}, "whole numbers of width, depth, heads, hidden"),
        ({"classifier_arguments": {"width": 16, "heads": 5}}, "5 heads cannot share a width of 16"),
        ({"patch": 0, "classifier": "mlp", "camera": "dmd", "bins": 40, "speed": 2.0,
          "pattern_width": 9, "masks": 40}, "give fewer `bins`"),
    ],
)  # fmt: skip
def test_what_scenes_or_a_network_do_not_fit_is_refused(settings, match):
    given = {**PAPER, **PATCH, "masks": 16, "photons": 1e4, **settings}
    with pytest.raises(InputError, match=match):
        learn(synthetic((16, 8)), **{name: each for name, each in given.items() if each != 0})


DAMAGES = {
    "range": [
        *({"exposure": {"masks": bad}} for bad in (2, 5)),
        *({"exposure": {name: 0.0}} for name in ("photons", "span")),
        {"exposure": {"used": -1.0}},
        {"exposure": {"nested": 2}},
    ],
    "patches": [
        *({"classifier": each} for each in ({"width": 32}, {"heads": 5}, {"patches": 3})),
        {"exposure": {"side": 2}},
        {"exposure": {"kind": "fixed"}},
    ],
    "passing": [{"exposure": {"bins": 5}}],
}


@pytest.mark.parametrize(
    ("kind", "damage"), [(kind, each) for kind, every in DAMAGES.items() for each in every], ids=str
)
def test_a_damaged_header_is_refused(tmp_path, kind, damage):
    path = shutil.copy(FOLDER / f"{kind}.safetensors", tmp_path)

    def change(header, _):
        for name, value in damage.items():
            header[name] = header[name] | value if isinstance(value, dict) else value

    rewrite(path, change)
    refused(path)


@pytest.mark.parametrize(
    "change",
    [lambda pattern: 1 - pattern, lambda pattern: 2 * pattern, lambda pattern: None],
    ids=["other", "bright", "lost"],
)
def test_a_pattern_that_is_not_that_of_the_masks_is_refused(tmp_path, change):
    path = shutil.copy(FOLDER / "passing.safetensors", tmp_path)

    def damaged(header, tensors):
        tensors["exposure.pattern"] = change(tensors.pop("exposure.pattern"))
        if tensors["exposure.pattern"] is None:
            del tensors["exposure.pattern"]

    rewrite(path, damaged)
    refused(path)
