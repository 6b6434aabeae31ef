"""What a page to play with holds of a design, and which designs it cannot play."""

from contextlib import nullcontext
from dataclasses import replace

import pytest
import torch

from deepfsi import Design, InputError
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
