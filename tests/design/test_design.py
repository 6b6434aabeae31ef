"""A design file gives the design back bit for bit, or one clear error; it never runs code."""

import copy
import os
import pickle
import random
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from conftest import PHOTONS, every_optics, light_on
from deepfsi import Design, evaluate
from deepfsi.base import InputError
from deepfsi.camera import share_out
from deepfsi.designfile.header import DESIGN_SCHEMA
from deepfsi.exposure import Observation
from shared import vectors
from shared.design_files import refused, rewrite
from shared.jobs import learn as learned


@pytest.fixture
def saved(made, tmp_path) -> Path:
    return made("deepfsi", "column", "dual").save(tmp_path / "design.safetensors")


def test_a_noise_that_a_file_names_is_not_run(digits, saved, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "foreign_noise.py").write_text("open('ran', 'w')\ndef noise(rates, generator): ...")
    rewrite(
        saved,
        lambda header, _: header["info"]["job"]["camera"].update(noise="foreign_noise:noise"),
    )
    loaded = Design.load(saved)
    with pytest.raises(InputError, match="a file does not run: give `noise`, it or another"):
        evaluate(loaded, digits, 1e4)
    assert evaluate(loaded, digits, 1e4, draws=1, noise="poisson")[0].noise == "poisson"
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("share", [0, 1e-9, 0.001, 0.02, 0.1, 0.5, 0.9, 1 - 1e-9])
def test_a_truncated_file_is_refused(saved, share):
    whole = saved.read_bytes()
    kept = min(len(whole) - 1, max(int(share * len(whole)), int(share > 0)))
    saved.write_bytes(whole[:kept])
    refused(saved)


@pytest.mark.parametrize("size", [1, 7, 8, 9, 100, 10_000])
def test_random_bytes_are_refused(tmp_path, size):
    path = tmp_path / "noise.safetensors"
    for seed in range(5):
        path.write_bytes(random.Random(seed).randbytes(size))
        refused(path)


class Bomb:
    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.target,)


@pytest.mark.parametrize("write", [torch.save, lambda o, p: p.write_bytes(pickle.dumps(o))])
def test_a_pickle_in_disguise_is_refused_and_not_run(tmp_path, write):
    path = tmp_path / "design.safetensors"
    write(Bomb(tmp_path / "ran"), path)
    refused(path)
    assert not (tmp_path / "ran").exists()


def test_a_file_of_another_version_is_called_so_and_a_damaged_one_is_not(saved):
    rewrite(saved, lambda header, _: (header.pop("exposure"), header.update(schema=3)))
    rewrite(saved, lambda header, _: header.update(deepfsi="0.1.0"))
    refused(
        saved, "written by deepfsi 0.1.0 with schema 3, older than .* make it again with `deepf"
    )
    rewrite(saved, lambda header, _: header.update(deepfsi="99.0.0", schema=DESIGN_SCHEMA))
    refused(saved, "written by deepfsi 99.0.0, newer than this one: upgrade deepfsi")
    rewrite(saved, lambda header, _: header.update(deepfsi=version("deepfsi")))
    refused(saved)


@pytest.mark.parametrize("metadata", [None, {"other": "x"}, {"deepfsi": "{"}, {"deepfsi": "[]"}])
def test_safetensors_without_our_header_are_refused(tmp_path, metadata):
    path = tmp_path / "other.safetensors"
    save_file({"rails": torch.ones(2, 3, 4)}, path, metadata)
    refused(path)


@pytest.mark.parametrize(
    "key",
    ["rails", "mean", "std", "shares", *(f"classifier.layers.{part}" for part in
                                         ("0.weight", "1.weight", "1.bias"))],
)  # fmt: skip
@pytest.mark.parametrize(
    "change",
    [
        lambda tensors, key: tensors.pop(key),
        lambda tensors, key: tensors.update({key: tensors[key][..., 1:].contiguous()}),
        lambda tensors, key: tensors[key].view(-1)[0].fill_(torch.nan),
        lambda tensors, key: tensors[key].view(-1)[0].fill_(torch.inf),
    ],
    ids=["missing", "another shape", "nan", "infinite"],
)
def test_a_damaged_tensor_is_refused(saved, key, change):
    rewrite(saved, lambda _, tensors: change(tensors, key))
    refused(saved)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("light", "sunlight"),
        ("summed_reflectance", 0.0),
        ("summed_reflectance", -3.0),
        ("summed_reflectance", float("nan")),
        ("summed_reflectance", "bright"),
        ("image_shape", [8, 9]),
        ("image_shape", "8x8"),
        ("classes", ["a", "b"]),
        ("classes", 10),
        ("classifier", {"kind": "mlp", "hidden": [9], "dropout": 0.0}),
        ("classifier", {"kind": "forest", "hidden": [8], "dropout": 0.0}),
        ("schema", "new"),
        ("schema", 0),
        ("light", "two-arm"),
        ("info", {"job": 3}),
        ("exposure", {"kind": "patches", "side": 8}),
        ("exposure", {"kind": "conditioned", "photons": 1e3, "span": 10.0, "masks": 7}),
    ],
)
def test_a_damaged_header_is_refused(saved, key, value):
    rewrite(saved, lambda header, _: header.update({key: value}))
    refused(saved)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda rails: -rails, id="negative"),
        pytest.param(lambda rails: 2 * rails, id="too-bright"),
        pytest.param(lambda rails: rails[[0, 1, 1]], id="three-rails"),
        pytest.param(lambda rails: rails[:0], id="no-rail"),
    ],
)
def test_rails_that_no_design_can_have_are_refused(saved, change):
    rewrite(saved, lambda _, tensors: tensors.update(rails=change(tensors["rails"]).contiguous()))
    with pytest.raises(InputError):
        Design.load(saved)


def test_only_mlps_can_be_saved(made, tmp_path):
    design = copy.copy(made("deepfsi", "column", "dual"))
    design.classifier = nn.Linear(7, 10)
    with pytest.raises(InputError, match="Linear classifier cannot be saved"):
        design.save(tmp_path / "design.safetensors")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("step", ["replace", "fsync"])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(saved, made, monkeypatch, step):
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    whole = saved.read_bytes()
    monkeypatch.setattr(os, step, full)
    with pytest.raises(InputError, match=r"cannot write .*No space left"):
        made("pca", "column", "dual").save(saved)
    assert list(saved.parent.iterdir()) == [saved]
    assert saved.read_bytes() == whole


@pytest.fixture(params=["dual", "single"])
def camera(request, made) -> Design:
    return made("deepfsi", "free-dwell", request.param)


def some_counts(design: Design, *lead: int) -> np.ndarray:
    rails = (2,) if design.rails.count == 2 else ()
    return np.random.default_rng(0).poisson(50, (*lead, *rails, design.masks))


def test_classify_takes_one_budget_or_one_for_each_exposure(camera):
    counts, budgets = some_counts(camera, 3, 2), np.array([[1e3, 1e4], [1e5, 2e3], [3e4, 1e4]])
    together = camera.classify(counts, budgets)
    for i, j in np.ndindex(3, 2):
        alone = camera.classify(counts[i, j][None], budgets[i, j])
        assert together[i, j] == pytest.approx(alone[0], abs=1e-6)
    assert np.allclose(
        camera.classify(counts, [1e3, 1e4])[:, 0], camera.classify(counts[:, 0], 1e3)
    )


@every_optics
def test_dimmer_patterns_are_classified_as_the_design_classifies(digits, made, light, rails):
    """Features are a tenth of the design's, and so are the statistics that scale them."""
    design = made("deepfsi", light, rails)
    dim = design.as_shown(0.1 * design.rails.stacked.numpy(), design.image_shape, 0.1)
    photons = light_on(design, digits.x_test[:50]).float()
    wanted, found = (each.logits(each.scanner("none")(photons), PHOTONS) for each in (design, dim))
    torch.testing.assert_close(found, wanted, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("kind", vectors.KINDS)
def test_it_answers_the_vectors(kind, tmp_path):
    """Which the file in NumPy and the page in JavaScript answer alike."""
    content, matrix, expected = vectors.read_vectors(kind)
    path = tmp_path / "design.safetensors"
    path.write_bytes(content)
    design = Design.load(path)
    np.testing.assert_allclose(design.matrix, matrix, atol=1e-7)
    for vector in expected:
        part = design if vector.masks == design.masks else design.first(vector.masks)
        counts = vector.counts[:, : vector.masks].reshape(part.counts_shape)
        photons = vector.photons * part.exposure.used / design.exposure.used
        dwell = None
        if vector.dwell is not None:
            dwell = design.exposure.dwells.by_rail(vector.dwell)
        chances = part.classify(counts, photons, dwell)
        np.testing.assert_allclose(chances, vector.chances, atol=vectors.AGREES)
        if vector.look is not None:
            exposure = design.exposure
            features = design.features_of(torch.from_numpy(counts).float()) / vector.photons
            seen = Observation(features, torch.from_numpy(vector.dwell).float())
            left = torch.tensor([1 - vector.look / exposure.looks])
            inputs = seen.inputs(design.mean, design.std)
            dwell = exposure.next_dwell(exposure.network, inputs, left).double().detach().numpy()
            dwell = share_out(dwell, exposure.shortest)
            np.testing.assert_allclose(dwell, vector.next_dwell, atol=vectors.AGREES)


@pytest.mark.parametrize("exposure", [{}, {"bins": 8}, {"looks": 2}, {"design": "adaptive"}])
@pytest.mark.usefixtures("uncharacterised")
def test_a_design_predicts_what_it_classifies_of_its_counts(digits, exposure):
    """Both as a test of the same scenes by the same noise; images and flat scenes alike."""
    few = replace(digits, x_test=digits.x_test[:40], y_test=digits.y_test[:40])
    given = {"camera": "dmd", "photons": 1e4, "masks": None if "bins" in exposure else 4}
    made = learned(few, epochs=1, device="cpu", **{**given, **exposure})
    images = few.x_test.reshape(5, 8, 8, 8)
    classes = made.predict(images, 1e4)
    assert classes.shape == (5, 8)
    assert (classes.ravel() == made.predict(torch.from_numpy(few.x_test), 1e4)).all()
    right = (classes.ravel() == np.array(few.classes)[few.y_test]).mean()
    assert right == pytest.approx(evaluate(made, few, 1e4, draws=1, seed=0)[0].accuracy)
    if exposure.keys() & {"looks", "design"}:
        with pytest.raises(InputError, match=r"its masks while|use `predict`"):
            made.expose(images, 1e4)
        return
    counts = made.expose(images, 1e4)
    assert counts.shape == (5, 8, *made.counts_shape)
    answers = made.classify(counts, 1e4).argmax(axis=-1)
    assert (np.array(made.classes)[answers] == classes).all()
    assert (counts != made.expose(images, 1e4, seed=1)).any()
    for bad, words in (
        (images[..., :7], r"give \(..., 8, 8\) or \(..., 64\)"),
        (2 * images, "in .0, 1.$"),
    ):
        with pytest.raises(InputError, match=words):
            made.expose(bad, 1e4)
