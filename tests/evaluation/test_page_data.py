"""What a page to play with holds of a design, and which designs it cannot play."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
import torch

from deepfsi import Design
from deepfsi.adaptive.posterior import ScenePrior
from deepfsi.base.errors import InputError
from deepfsi.evaluation.page_data import check_playable
from golden.file_cases import FOLDER

READ = {"light": "column", "noise": "camera", "dark": 5, "sigma": 2}


def under(camera):
    return {"info": {"job": {"camera": camera}}}


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"classifier": torch.nn.Linear(7, 10)}, "give a design with the package's own"),
        (
            under({"light": "column", "noise": "shared.noises:photons"}),
            r"for shared\.noises:photons noise",
        ),
        (under(READ), "camera noise with sigma 2"),
        (under({**READ, "noise": "gaussian", "dark": 0}), "for gaussian noise"),
        (under({**READ, "sigma": 0}), ""),
        ({}, ""),
    ],
)
def test_what_a_page_cannot_play_is_refused(made, changes, match):
    design = replace(made("deepfsi", "column", "dual"), **changes)
    with pytest.raises(InputError, match=match) if match else nullcontext():
        check_playable(design)
    with pytest.raises(InputError, match="of image patches"):
        check_playable(Design.load(FOLDER / "patches.safetensors"))


def test_a_page_has_scenes_of_each_class_by_lot():
    rng = np.random.default_rng(0)
    labels = np.repeat(np.arange(4), [1, 20, 300, 79])
    prior = ScenePrior(rng.random((400, 6)).astype(np.float32), labels, 4, spread=0.5)
    few, again, other = prior.subset(100, 1), prior.subset(100, 1), prior.subset(100, 2)
    assert few.sizes == [1, 5, 75, 19]
    assert torch.equal(few.coefficients, again.coefficients)
    assert not torch.equal(few.coefficients, other.coefficients)
    step = prior.coefficients.abs().amax(dim=0) / 127
    far = (few.coefficients[:, None] - prior.coefficients).abs()
    found = (far <= 0.501 * step).all(dim=2).nonzero()[:, 1]
    assert len(found) == 100  # each is one of them, and no other
    assert torch.equal(few.labels, prior.labels[found])
    assert prior.subset(10**6).sizes == prior.sizes
