"""Designs of scenes that pass a pattern: training, test, file, and what does not apply."""

import pytest
import torch

import deepfsi
from conftest import RECIPE, generator, synthetic
from deepfsi import Design
from deepfsi.base import InputError
from shared.design_files import refused, rewrite

pytestmark = pytest.mark.usefixtures("all_trained_once")

PASSING = {"bins": 6, "speed": 1.5, "jitter": 1.0, "speed_jitter": 0.05}


@pytest.fixture(scope="module")
def data():
    return synthetic((4, 6))


def made(data, design="deepfsi", camera=None, exposure=None, **training) -> Design:
    return deepfsi.learn(
        data,
        design=design,
        photons=1e4,
        camera=camera,
        exposure=exposure or PASSING,
        training={**RECIPE, **training},
    )


@pytest.fixture(scope="module")
def learned(data):
    return made(data, epochs=30, mask_lr=0.2, hidden=(32,), lr=1e-2)


def test_a_learned_pattern_reads_what_a_blind_guess_does_not(data, learned):
    [result] = deepfsi.evaluate(learned, data, 1e4)
    assert result.accuracy > 0.6  # of three classes
    assert result.counts <= 1e4 * data.x_test.sum() / len(data.x_test) / learned.summed_reflectance
    assert result.counts / 1e4 == pytest.approx(result.throughput, rel=0.1)
    assert learned.light == "equal-dwell"
    assert learned.masks == 6
    # P is W + T v unless given
    assert learned.exposure.pattern.shape == (4, 6 + 9)


def test_each_exposure_of_a_test_has_a_place_of_its_own(data, learned):
    """The counts of one scene, its place unknown, vary by more than photon noise."""
    scanner = learned.front_end(learned.camera)
    one = torch.from_numpy(data.x_test[:1]).expand(20_000, -1)
    with torch.no_grad():
        rates = learned.rates(scanner, one)
        [seen] = learned.observe(scanner, rates, generator(), 1e4)
    placed = learned.exposure.placed(rates, generator(1))[:, 0] * 1e4
    counts = seen.features * 1e4
    assert torch.equal(counts.round(), counts.round(decimals=2).round())
    assert ((placed.var(dim=0) / placed.mean(dim=0)).max()) > 1  # jitter is seen at this budget
    for t in range(6):
        spread = float(placed[:, t].var() + placed[:, t].mean())
        mean_error = 5 * (2 * spread / 20_000) ** 0.5
        assert abs(counts[:, t].mean() - placed[:, t].mean()) < mean_error
        assert float(counts[:, t].var()) == pytest.approx(spread, rel=0.15)
    shown = learned.exposure.expected(rates[:1], seen)[0, 0] * 1e4
    error = 5 * (placed.var(dim=0) * (1 / 1024 + 1 / 20_000)).sqrt()
    assert ((shown - placed.mean(dim=0)).abs() <= error).all()


def test_damaged_files_are_refused(data, learned, tmp_path):
    def other(header, tensors):
        tensors["exposure.pattern"] = 1 - tensors["exposure.pattern"]

    def bright(header, tensors):
        tensors["exposure.pattern"] = 2 * tensors["exposure.pattern"]

    def lost(header, tensors):
        del tensors["exposure.pattern"]

    def short(header, tensors):
        header["exposure"]["bins"] = 5

    for change in (other, bright, lost, short):
        path = learned.save(tmp_path / "one.safetensors")
        rewrite(path, change)
        refused(path)


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"design": "pca"}, "pca is a set of masks, and scenes pass one pattern"),
        ({"design": "raster", "masks": 24}, "raster is a set of masks"),
        ({"masks": 5}, "5 masks and 6 bins are one number"),
        ({"camera": "two-arm"}, "give single rails"),
        ({"camera": "paper"}, "give single rails"),
        ({"camera": "dmd-2x2"}, "no `detectors`"),
        ({"camera": {"device": "dlp7000"}}, "no `device`"),
        ({"training": {"start": "pca"}}, "starts at random"),
        ({"exposure": {"bins": 40, "speed": 2.0, "pattern_width": 9}}, "have a|of 6 columns pass"),
        ({"exposure": {"bins": 6, "looks": 4}}, "are of different exposures"),
        ({"exposure": {"bins": 1}}, "bins = 1: give 2 or more"),
        ({"exposure": {"speed": 0}}, "speed = 0: give more than 0"),
    ],
    ids=str,
)
def test_what_does_not_apply_is_one_line(data, settings, match):
    with pytest.raises(InputError, match=match) as error:
        deepfsi.learn(data, **{"photons": 1e4, "exposure": PASSING, **settings})
    assert "\n" not in str(error.value)
