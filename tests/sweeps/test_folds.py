"""Folds: every scene is tested once, and their records count as one test of all scenes."""

import numpy as np
import pytest

from conftest import synthetic
from deepfsi import InputError, evaluate, from_arrays, load_dataset, load_design
from deepfsi.base.intervals import accuracy_interval, unpack_values
from deepfsi.designfile.provenance import trained_on
from deepfsi.lab.design_data import data_of
from deepfsi.sweeps.plan import check_settings
from deepfsi.sweeps.run import compare
from shared.trials import small

FEW = {"designs": "deepfsi", "photons": 1e3, "masks": 3, "training": {"epochs": 1}, "folds": None}


@pytest.fixture(scope="module")
def few():
    return synthetic((4, 4), scenes=60)


def test_few_scenes_are_tested_in_folds(few, tmp_path):
    """The interval is that of sixty images, each once, where one test part has twelve."""
    recipe = small(**FEW, trials=2)
    results, records = compare(recipe, few, tmp_path, command="deepfsi")
    (point,) = results.points
    assert (results.data.folds, results.data.test, results.data.train) == (5, 60, 40)
    assert (results.data.name, results.data.hash) == (few.name, few.hash)
    assert (point.trials, len(point.keys), len(records)) == (2, 10, 10)
    rows = np.stack([unpack_values(text) for text in point.terms])
    assert rows.shape == (2, 60)
    assert point.accuracies == pytest.approx(rows.mean(axis=1))
    assert (point.low, point.high) == pytest.approx(accuracy_interval(rows)[1:], abs=1e-6)
    assert np.sum(point.confusion) == 2 * 60
    assert "5 folds" in point.covers
    assert "images" in point.covers
    # each fold's part is what its own design gives to scenes that it was not trained on
    for place, (key, part) in enumerate(zip(point.keys, few.folds(5), strict=False)):
        design = load_design(tmp_path / "designs" / f"{key}.safetensors")
        assert trained_on(design.info).is_of(part)
        [alone] = evaluate(design, part, 1e3, draws=1)
        assert rows[0, 12 * place : 12 * place + 12] == pytest.approx(alone.right, abs=1e-6)


def test_one_test_part_where_it_is_large_or_asked_for(few, digits):
    assert small(folds=None).parts(digits) == [digits]
    assert small(folds=1).parts(few) == [few]
    assert len(small(folds=3).parts(digits)) == 3
    own = few.hold_out()
    assert small(folds=None).parts(own) == [own]
    with pytest.raises(InputError, match="leave `folds` out"):
        check_settings({"folds": 3, "masks": 3}, lambda _: own)
    with pytest.raises(InputError, match="60 folds of 20 scenes"):
        check_settings({"folds": 60, "masks": 3}, lambda _: few)


def test_a_design_of_a_fold_is_tested_on_the_scenes_of_its_fold(few, tmp_path):
    """It remembers its fold: the test part of the whole data holds scenes that it learned."""
    path = tmp_path / "few.npz"
    x = np.concatenate([few.x_train, few.x_test]).reshape(-1, 4, 4)
    np.savez(path, x=x, y=np.concatenate([few.y_train, few.y_test]))
    data = load_dataset(path)
    results, _ = compare(small(**FEW), data, tmp_path / "run", command="deepfsi")
    design = load_design(tmp_path / "run" / "designs" / f"{results.points[0].keys[1]}.safetensors")
    again, notes = data_of(design)
    assert again.hash == data.folds(5)[1].hash
    assert notes == ()
    assert "fold 2 of 5" in trained_on(design.info).words


def test_values_are_tested_in_as_many_folds_as_are_asked_for(tmp_path):
    x = np.random.default_rng(0).random((60, 16))
    data = from_arrays(x, x[:, :4].mean(axis=1), values=["corner"])
    recipe, _ = check_settings(small(**{**FEW, "folds": 3}).model_dump(), lambda _: data)
    results, records = compare(recipe, data, tmp_path, command="deepfsi")
    assert (results.data.folds, results.data.test, len(records)) == (3, 60, 3)
    (point,) = results.points
    [terms] = [unpack_values(text) for text in point.terms]
    assert len(terms) == 60
    assert point.accuracy == pytest.approx(terms.mean(), abs=1e-6)
    assert len(point.rmse) == 1


def test_scenes_that_are_there_twice_are_not_tested_in_folds_that_were_trained_on_them(tmp_path):
    """Each of two equal scenes in different folds is of the training where the other is tested."""
    x = np.random.default_rng(0).random((60, 5, 5))
    y = np.arange(60) % 2
    x[y == 1] *= 0.5
    x[[30, 31, 40]] = x[[2, 3, 2]]
    data = from_arrays(x, y, name="twice")
    recipe = small(designs="raster", masks=25, folds=5)
    results, _ = compare(recipe, data, tmp_path, command="")
    point = results.points[0]
    tested = len(unpack_values(point.terms[0]))
    assert results.data.folds == 5
    assert 55 <= tested < 60
