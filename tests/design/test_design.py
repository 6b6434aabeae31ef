"""A design file gives the design back bit for bit, or one clear error; it never runs code."""

import io
import pickle
import random
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from conftest import PHOTONS, every_optics, light_on, quick
from deepfsi import Design, InputError, evaluate, load_design, predict
from shared.design_files import refused, rewrite
from shared.jobs import learn


@pytest.fixture
def saved(made, tmp_path) -> Path:
    return made("deepfsi", "column", "dual").save(tmp_path / "design.safetensors")


def test_a_noise_that_a_file_names_is_not_run(digits, saved, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "foreign_noise.py").write_text("open('ran', 'w')\ndef noise(rates, generator): ...")
    camera = {"noise": "foreign_noise:noise"}
    rewrite(saved, lambda header, _: header["info"]["job"]["camera"].update(camera))
    loaded = Design.load(saved)
    with pytest.raises(InputError, match="a file does not run: give `noise`, it or another"):
        evaluate(loaded, digits, 1e4)
    assert evaluate(loaded, digits, 1e4, draws=1, noise="poisson")[0].noise == "poisson"
    assert not (tmp_path / "ran").exists()


def test_no_file_beside_a_design_is_imported_for_it(saved, tmp_path, monkeypatch):
    """Kinds of exposure and classifiers of the package are found without the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [path for path in sys.path if path not in ("", str(tmp_path))])
    for file in (saved, "dmd-mnist", "adaptive-mnist"):
        load_design(file)
    assert str(tmp_path) not in sys.path


class Bomb:
    def __reduce__(self):
        return Path.touch, (Path("ran"),)


def zipped(thing) -> bytes:
    torch.save(thing, buffer := io.BytesIO())
    return buffer.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        lambda whole: whole[:-1],
        lambda _: random.Random(9).randbytes(9),
        lambda _: pickle.dumps(Bomb()),
        lambda _: zipped(Bomb()),
    ],
)
def test_a_truncated_or_foreign_file_is_refused_and_not_run(saved, monkeypatch, content):
    monkeypatch.chdir(saved.parent)
    saved.write_bytes(content(saved.read_bytes()))
    refused(saved)
    assert not Path("ran").exists()


@pytest.mark.parametrize("rails", ["dual", "single"])
def test_classify_takes_one_budget_or_one_for_each_exposure(made, rails):
    design = made("deepfsi", "free-dwell", rails)
    counts = np.random.default_rng(0).poisson(50, (3, 2, *design.counts_shape))
    budgets = np.array([[1e3, 1e4], [1e5, 2e3], [3e4, 1e4]])
    together = design.classify(counts, budgets)
    for index in np.ndindex(3, 2):
        alone = design.classify(counts[index][None], budgets[index])
        assert together[index] == pytest.approx(alone[0], abs=1e-6)
    one = design.classify(counts[:, 0], 1e3)
    assert np.allclose(design.classify(counts, [1e3, 1e4])[:, 0], one)


@every_optics
def test_dimmer_patterns_are_classified_as_the_design_classifies(digits, made, light, rails):
    """Features are a tenth of the design's, and so are the statistics that scale them."""
    design = made("deepfsi", light, rails)
    dim = design.as_shown(0.1 * design.rails.stacked.numpy(), design.image_shape, 0.1)
    photons = light_on(design, digits.x_test[:50]).float()
    features = [each.scanner("none")(photons) / PHOTONS for each in (design, dim)]
    wanted, logits = map(Design.answer, (design, dim), features, (PHOTONS, PHOTONS))
    torch.testing.assert_close(logits.logits, wanted.logits, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("exposure", [{}, {"bins": 8}, {"design": "adaptive"}])
@pytest.mark.usefixtures("uncharacterised")
def test_pictures_are_predicted_as_their_counts_are_classified(digits, exposure):
    """Both as a test of the same scenes by the same noise."""
    few = replace(digits, x_test=digits.x_test[:40], y_test=digits.y_test[:40])
    given = {"camera": "dmd", "photons": 1e4, "masks": None if "bins" in exposure else 4}
    brief = {} if "design" in exposure else {"epochs": 1}
    made = learn(few, device="cpu", **{**given, **brief, **exposure})
    images = few.x_test.reshape(5, 8, 8, 8)
    classes = np.array([each.predicted for each in predict(made, few.x_test, 1e4).scenes])
    right = (classes == np.array(few.classes)[few.y_test]).mean()
    assert right == pytest.approx(evaluate(made, few, 1e4, draws=1, seed=0)[0].accuracy)
    if "design" in exposure:
        with pytest.raises(InputError, match="its masks while"):
            made.expose(images, 1e4)
        return
    counts = made.expose(images, 1e4)
    assert counts.shape == (5, 8, *made.counts_shape)
    answers = made.classify(counts, 1e4).argmax(axis=-1)
    assert (np.array(made.classes)[answers].ravel() == classes).all()
    assert (counts != made.expose(images, 1e4, seed=1)).any()
    for bad, words in ((images[..., :7], r"give \(..., 8, 8\)"), (2 * images, "in .0, 1.$")):
        with pytest.raises(InputError, match=words):
            made.expose(bad, 1e4)


def test_budgets_that_are_not_of_the_exposures_are_refused(made):
    design = made("deepfsi", "column", "dual")
    counts = np.ones((4, *design.counts_shape))
    with pytest.raises(InputError, match=r"photons of shape \(3,\) do not fit counts of \(4,\)"):
        design.classify(counts, np.full(3, 1e4))


FEW = 60.0


@pytest.fixture(scope="module")
def clicking(digits):
    return quick(digits, noise="click", gates=2, rails="single", photons=FEW)


def test_counts_of_a_result_are_clicks_and_it_says_what_arrives(clicking, digits):
    """Against the closed form of the test scenes' rates."""
    [result] = evaluate(clicking, digits, FEW, draws=1)
    rates = clicking.exposure.rates(clicking.scanner(), torch.from_numpy(digits.x_test)) * FEW
    clicks = 2 * (1 - torch.exp(-rates.double() / 2))
    assert result.noise == "click"
    assert result.counts == pytest.approx(float(clicks.flatten(1).sum(dim=1).mean()), rel=1e-4)
    assert result.arriving == pytest.approx(float(rates.flatten(1).sum(dim=1).mean()), rel=1e-4)
    assert result.counts < result.arriving
    [photons] = evaluate(clicking, digits, FEW, noise="poisson", draws=1)
    assert photons.counts == photons.arriving == pytest.approx(result.arriving, rel=1e-6)
