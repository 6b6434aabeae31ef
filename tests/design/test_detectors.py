"""Designs for several detectors, and designs whose network reads both rails."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from conftest import generator, once
from deepfsi.networks.classifiers import stop_temperatures
from deepfsi.physics.detection import Detection
from deepfsi.physics.laws import ROUNDING_SLACK, light_law

KINDS = {
    "fixed": {},
    "levels": {"levels": 2},
    "range": {"span": 100.0},
}
OPTICS = [
    ("free-dwell", "single", None),
    ("equal-dwell", "dual", "difference"),
    ("free-dwell", "dual", "both"),
    ("two-arm", "dual", None),
    ("two-arm", "dual", "difference"),
]


CASES = [(kind, *optics) for kind in KINDS for optics in OPTICS]


def trained(digits, kind="fixed", light="free-dwell", rails="single", readout=None, **settings):
    words = {"masks": 5, "detectors": "2x2", **KINDS[kind], **settings}
    words |= {} if readout is None else {"readout": readout}
    return once(digits, light=light, rails=rails, **words)


@pytest.mark.parametrize(("kind", "light", "rails", "readout"), CASES)
def test_every_kind_of_design_works_with_several_detectors(digits, kind, light, rails, readout):
    """It obeys its law, and classifies counts as it was tested."""
    design = trained(digits, kind, light, rails, readout)
    assert light_law(light).excess(design.rails.stacked) <= ROUNDING_SLACK
    assert design.counts_shape == ((5, 4) if rails == "single" else (2, 5, 4))
    read = "both" if light == "two-arm" else "difference"
    assert design.detection.readout == (readout or read)
    scanner = design.scanner()
    rates = design.rates(scanner, torch.from_numpy(digits.x_test[:30]))
    counts = scanner.read(rates * 1e4, generator(7))
    shown = counts.reshape(30, *design.counts_shape).numpy()
    logits = design.logits(design.detection.features(counts), 1e4).detach()
    by_hand = (logits / stop_temperatures(design.temperatures, 1e4)[-1]).softmax(-1)
    np.testing.assert_allclose(design.classify(shown, 1e4), by_hand, atol=1e-6)


def test_the_light_of_all_detectors_is_that_of_one(digits):
    """Tiles divide the light, they do not add to it."""
    design = trained(digits, masks=6)
    one = replace(design, exposure=design.mask_exposure.with_optics(detection=Detection()))
    x = torch.from_numpy(digits.x_train[:200])
    rates = [each.rates(each.scanner("none"), x) for each in (design, one)]
    assert torch.allclose(rates[0].unflatten(-1, (6, 4)).sum(dim=-1), rates[1], rtol=1e-5)
    assert float(design.shares.sum()) <= 1 + 1e-6
