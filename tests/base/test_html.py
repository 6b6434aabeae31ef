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
from deepfsi.base.numeric import (
    confusion_shares,
    confusion_table,
    frequent_confusions,
    mask_picture,
)

CONFUSION = [[8, 2, 0], [0, 10, 0], [5, 0, 15]]


def pixels(html):
    found = re.search(r"base64,([^\']+)", html)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(found[1]))))


def test_shares_are_of_the_true_classes():
    assert confusion_shares(CONFUSION) == pytest.approx(
        np.array([[0.8, 0.2, 0], [0, 1, 0], [0.25, 0, 0.75]])
    )
    assert confusion_shares([[0, 0], [1, 1]]).tolist() == [[0, 0], [0.5, 0.5]]
    assert frequent_confusions(CONFUSION) == [(2, 0, 0.25), (0, 1, 0.2)]


def test_a_confusion_matrix_is_a_table():
    table = ElementTree.fromstring(confusion_table(CONFUSION, ("a", "<b>", "c")))
    rows = [[cell.text for cell in row] for row in table.iter("tr")]
    assert rows[0][1:] == ["a", "<b>", "c"]
    assert rows[1] == ["a", "80.0", "20.0", None]
    assert rows[3] == ["c", "25.0", None, "75.0"]
    many = np.eye(21, dtype=int)
    many[4, 7] = 3
    text = confusion_table(many.tolist(), [f"class{k}" for k in range(21)])
    assert "<th scope='row'>class4</th><td>class7</td><td>75.0%</td>" in text
    assert "class5" not in text


def test_masks_are_drawn_with_their_signs():
    masks = np.zeros((2, 4))
    masks[0, 0], masks[1, 3] = 1, -1
    drawn = pixels(mask_picture(masks, (2, 2)))
    assert drawn.shape == (3, 6, 3), "two masks side by side, a line around each"
    assert drawn[0, 0].tolist() == [178, 24, 43]
    assert drawn[1, 4].tolist() == [33, 102, 172]
    assert (drawn[0, 1] == 255).all()
    assert pixels(mask_picture(np.ones((3, 5)), (5,))).shape == (3, 5, 3)


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


def test_representations_are_short_and_names_public(digits):
    assert repr(digits) == "<Dataset digits: 1437 training and 360 test scenes of 8x8, 10 classes>"
    assert sorted(dir(deepfsi)) == sorted([*deepfsi.__all__, "__version__"])


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
