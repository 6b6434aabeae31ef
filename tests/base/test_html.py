"""What a notebook shows, and one line for what a user gives in Python."""

import base64
import io
import re
from functools import partial
from xml.etree import ElementTree

import numpy as np
import pytest
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


class Pairs:
    """A data set of torch."""


LEARN = partial(deepfsi.learn, "digits", masks=2, training={"epochs": 1})


@pytest.mark.parametrize(
    ("make", "fields", "said"),
    [
        (deepfsi.Training, {"classifier": None}, "classifier = None: give mlp, or"),
        (deepfsi.Training, {"epochs": 0}, "epochs = 0"),
        (deepfsi.Camera, {"light": "sun"}, "light = 'sun'"),
        (deepfsi.Range, {"span": "many"}, "span = 'many'"),
        (deepfsi.Job, {"photons": True, "masks": 2}, "budget True is not allowed.* such as 1e4"),
        (LEARN, {"photons": 1, "training": {"classifier": None}}, "training.classifier = None"),
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
