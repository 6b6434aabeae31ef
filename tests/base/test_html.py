"""What a notebook shows, and one line for what a user gives in Python."""

import base64
import io
import re
from xml.etree import ElementTree

import numpy as np
import pytest
import torch
from PIL import Image

import deepfsi
from deepfsi import InputError, evaluate


def pixels(html):
    found = re.search(r"base64,([^\']+)", html)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(found[1]))))


def test_a_design_and_results_are_shown_in_a_notebook(good, digits):
    html = good._repr_html_()
    assert repr(good)[1:-1] in html
    assert pixels(html).shape[2] == 3
    results = evaluate(good, digits, [1e2, 1e4], draws=1)
    curve = ElementTree.fromstring(results._repr_html_())
    heights = [float(circle.get("cy")) for circle in curve.iter("circle")]
    assert heights[0] > heights[1], "more light, more accuracy, higher on the screen"
    assert [text.text for text in curve.iter("text")][-3:] == ["100", "1e+04", "photons"]
    assert f"accuracy {results[0].accuracy:.3f}" in results[0]._repr_html_()
    assert "<table" in results[0]._repr_html_()
    assert results == list(results)


class Pairs(torch.utils.data.Dataset):
    """A data set of torch."""

    def __len__(self):
        return 4

    def __getitem__(self, place):
        return torch.zeros(2, 2), place % 2


FEW = {"epochs": 1}


@pytest.mark.parametrize(
    ("make", "parts"),
    [
        (lambda: deepfsi.Training(classifier=None), ("classifier = None: give mlp, or",)),
        (lambda: deepfsi.Training(epochs=0), ("epochs = 0",)),
        (lambda: deepfsi.Camera(light="sun"), ("light = 'sun'",)),
        (lambda: deepfsi.Looks(looks="many"), ("looks = 'many'",)),
        (
            lambda: deepfsi.learn("digits", photons=1, masks=2, training={"classifier": None}),
            ("training.classifier = None: give mlp, or",),
        ),
        (
            lambda: deepfsi.learn("digits", photons=True, masks=2, training=FEW),
            ("photon budget True is not allowed", "such as 1e4"),
        ),
        (lambda: deepfsi.Job(photons=True, masks=2), ("photon budget True is not allowed",)),
        (
            lambda: deepfsi.learn("digits", counts=True, masks=2, training=FEW),
            ("True counts are not allowed",),
        ),
        (
            lambda: deepfsi.learn("digits", photons=(1e3, 1e4), masks=2, training=FEW),
            ("(1000.0, 10000.0) is no number", "exposure=Range(span=...)"),
        ),
        (
            lambda: deepfsi.learn(Pairs(), photons=1e3, masks=2, training=FEW),
            ("data were given as Pairs", "of a torch data set make two such arrays"),
        ),
        (lambda: deepfsi.load_dataset(Pairs()), ("data were given as Pairs", "give a Dataset")),
    ],
)
def test_a_setting_that_cannot_be_is_one_line(make, parts):
    with pytest.raises(InputError) as error:
        make()
    assert "\n" not in str(error.value)
    for part in parts:
        assert part in str(error.value)
