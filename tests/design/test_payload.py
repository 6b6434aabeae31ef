"""What a page to play with holds of a design, and which designs it cannot play."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import synthetic
from deepfsi.design.exposure.trained import PatchExposure
from deepfsi.design.payload import check_playable, playable
from deepfsi.errors import InputError
from deepfsi.report.playground.page import write_page
from shared.playground import large_design


def test_the_page_of_a_large_design_is_small(tmp_path):
    data = replace(synthetic((32, 32), scenes=100, classes=10), classes=tuple("0123456789"))
    page = write_page(tmp_path / "page.html", playable(large_design(), data))
    assert 1e6 < page.stat().st_size < 3e6


def test_what_a_page_cannot_play_is_refused(made):
    good = made("deepfsi", "column", "dual")
    with pytest.raises(InputError, match="own in it: give a design with the package's own"):
        check_playable(replace(good, classifier=torch.nn.Linear(7, 10)))
    other = replace(
        good, info={"job": {"camera": {"light": "column", "noise": "shared.noises:photons"}}}
    )
    with pytest.raises(InputError, match=r"for shared\.noises:photons noise"):
        check_playable(other)
    with pytest.raises(InputError, match="of image patches"):
        check_playable(replace(good, exposure=PatchExposure(4)))
    assert check_playable(good) is good.classifier


def test_the_flattest_training_scene_is_the_one_of_the_least_spread(made, digits):
    """The page says where what is drawn is flatter than that."""
    held = playable(made("deepfsi", "column", "dual"), digits)["scenes"]
    spreads = [np.sqrt(((scene - scene.mean()) ** 2).mean()) for scene in digits.x_train]
    assert held["flattest"] == pytest.approx(min(spreads), rel=1e-5)


def test_a_design_that_does_not_say_what_it_was_learned_for(made, digits):
    """Nothing is marked then; a budget beyond the slider is not measured."""
    design = made("deepfsi", "column", "dual")
    unknown = playable(replace(design, info={}), digits)
    assert unknown["budget"] is None
    assert unknown["rules"] == []
    far = playable(
        replace(made("deepfsi", "column", "dual"), info={"job": {"photons": 1e8}}), digits
    )
    assert far["budget"] == {"low": 1e8, "high": 1e8}
    assert len(far["curve"]) == len(unknown["curve"]) == 13
