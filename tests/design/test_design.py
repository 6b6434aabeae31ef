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

from conftest import PHOTONS, RECIPE, every_optics, light_on, quick
from deepfsi import Camera, Design, evaluate
from deepfsi.base import InputError
from deepfsi.camera import share_out
from deepfsi.designfile.header import DESIGN_SCHEMA
from deepfsi.evaluation import camera_for
from deepfsi.exposure import Observation, TrainingSet
from deepfsi.physics import Detection
from deepfsi.training import train
from shared import vectors
from shared.design_files import refused, rewrite
from shared.jobs import job
from shared.jobs import learn as learned


@pytest.fixture
def saved(made, tmp_path) -> Path:
    return made("deepfsi", "column", "dual").save(tmp_path / "design.safetensors")


def test_a_design_trained_with_others_saves_only_itself(digits, tmp_path):
    jobs = [job(masks=5, photons=photons, **RECIPE) for photons in (1e3, 1e5)]
    for design in train(TrainingSet(digits, "cpu"), jobs):
        path = design.save(tmp_path / "design.safetensors")
        assert path.stat().st_size < 25_000
        assert torch.equal(Design.load(path).rails.stacked, design.rails.stacked)


@every_optics
def test_the_file_keeps_the_camera_that_it_was_trained_for(digits, tmp_path, light, rails):
    given = Camera(light=light, rails=rails, exposure="10ms", flux=1e6, dark=300, sigma=2, levels=2)
    made = quick(digits, camera=given, masks=5)
    loaded = Design.load(made.save(tmp_path / "design.safetensors"))
    assert loaded.camera == made.camera == given
    assert camera_for(loaded, noise="gaussian").sigma == 2
    assert camera_for(loaded, noise="poisson").dark == 0
    assert camera_for(loaded, dark=700).dark_counts == 7


@every_optics
def test_a_file_that_knows_no_camera_has_its_optics(made, tmp_path, light, rails):
    """Files of before there were cameras."""
    path = made("deepfsi", light, rails).save(tmp_path / "design.safetensors")
    rewrite(path, lambda header, _: header["info"]["job"].pop("camera"))
    camera = Design.load(path).camera
    assert (camera.light, camera.rails) == (light, rails)
    assert (camera.noise, camera.dark) == ("poisson", 0)
    rewrite(path, lambda header, _: header.update(info={}))
    assert Design.load(path).camera == camera


def test_a_file_that_knows_no_camera_has_its_detectors(digits, tmp_path):
    path = quick(digits, light="two-arm", detectors="2x2").save(tmp_path / "design.safetensors")
    rewrite(path, lambda header, _: header.update(info={}))
    loaded = Design.load(path)
    assert Detection.of(loaded.camera, (8, 8)).key == loaded.detection.key
    assert loaded.camera.readout == loaded.detection.readout


def test_a_camera_that_cannot_be_is_one_line(saved):
    rewrite(saved, lambda header, _: header["info"]["job"]["camera"].update(light="colum"))
    with pytest.raises(InputError, match="the design's camera cannot be used at light") as error:
        Design.load(saved).camera  # noqa: B018
    assert "\n" not in str(error.value)


def test_noise_follows_again_from_what_a_file_keeps(digits, saved):
    """Of a camera that gave neither noise nor sigma."""
    loaded = Design.load(saved)
    assert (camera_for(loaded, dark=5.0).noise, camera_for(loaded, dark=5.0).sigma) == ("camera", 0)
    noisy = quick(digits, dark=5.0)
    assert camera_for(noisy, noise="gaussian").sigma == 1


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


def test_a_missing_file_is_named(tmp_path):
    refused(tmp_path / "none.safetensors", "no design file at .*none.safetensors")
    refused(tmp_path, "cannot be read")


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


def test_a_newer_schema_is_said_even_if_all_else_changed(saved):
    rewrite(saved, lambda header, tensors: (header.clear(), header.update(schema=99)))
    refused(saved, "upgrade deepfsi")


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


def test_a_spread_of_zero_is_refused(saved):
    rewrite(saved, lambda _, tensors: tensors["std"].zero_())
    refused(saved)


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


@pytest.mark.parametrize("lead", [(), (1,), (4,), (3, 2), (0,)])
def test_classify_gives_probabilities_for_any_leading_shape(camera, lead):
    chances = camera.classify(some_counts(camera, *lead), photons=1e4)
    assert chances.shape == (*lead, 10)
    assert np.allclose(chances.sum(axis=-1), 1, atol=1e-5)
    assert (chances >= 0).all()


def test_classify_takes_one_budget_or_one_for_each_exposure(camera):
    counts, budgets = some_counts(camera, 3, 2), np.array([[1e3, 1e4], [1e5, 2e3], [3e4, 1e4]])
    together = camera.classify(counts, budgets)
    for i, j in np.ndindex(3, 2):
        alone = camera.classify(counts[i, j][None], budgets[i, j])
        assert together[i, j] == pytest.approx(alone[0], abs=1e-6)
    assert np.allclose(
        camera.classify(counts, [1e3, 1e4])[:, 0], camera.classify(counts[:, 0], 1e3)
    )


@pytest.mark.parametrize("kind", [list, np.uint16, np.int64, np.float64, torch.tensor])
def test_classify_takes_any_array_of_counts(camera, kind):
    counts = some_counts(camera, 3)
    given = counts.tolist() if kind is list else kind(counts)
    assert (camera.classify(given, 1e4) == camera.classify(counts, 1e4)).all()


def test_classify_refuses_counts_of_another_shape(camera):
    good = some_counts(camera, 3)
    for bad in (good[..., 1:], good[0, ..., 0], 5.0, [], [[1.0, 2.0]]):
        with pytest.raises(InputError, match="do not fit this design"):
            camera.classify(bad, 1e4)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_classify_refuses_counts_that_are_not_finite(camera, bad):
    counts = some_counts(camera, 3).astype(float)
    counts[1, ..., 2] = bad
    with pytest.raises(InputError, match="finite counts"):
        camera.classify(counts, 1e4)


@pytest.mark.parametrize("bad", [0, -1, np.nan, np.inf, [1e4, 0, 1e4], "abc", None])
def test_classify_refuses_budgets_that_are_not_above_zero(camera, bad):
    with pytest.raises(InputError):
        camera.classify(some_counts(camera, 3), bad)


@pytest.mark.parametrize("bad", ["abc", [[1, 2], [3]], None])
def test_classify_refuses_counts_that_are_not_numbers(camera, bad):
    with pytest.raises(InputError):
        camera.classify(bad, 1e4)


def test_classify_refuses_budgets_of_another_shape(camera):
    for bad in ([1e4, 1e4], [[1e4], [1e4], [1e4]]):
        with pytest.raises(InputError, match="photons of shape"):
            camera.classify(some_counts(camera, 3), bad)


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
