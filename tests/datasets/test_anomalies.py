"""One class against anomalies that are made of its own scenes."""

import numpy as np
import pytest

from deepfsi.base import InputError
from deepfsi.datasets import load_dataset
from deepfsi.datasets.variants import anomalies_of, one_class


@pytest.fixture(scope="module")
def three():
    return load_dataset("digits", normal="3")


def test_a_training_sees_scenes_of_the_normal_class_alone(three):
    """Half are its scenes; each anomaly is none of the data's scenes, of this class or another."""
    whole = load_dataset("digits")
    rows = {x.tobytes() for x in whole.x_train}
    normal = three.x_train[three.y_train == 0]
    assert {x.tobytes() for x in normal} == {x.tobytes() for x in whole.x_train[whole.y_train == 3]}
    made = three.x_train[three.y_train == 1]
    assert len(made) == len(normal)
    assert np.mean([x.tobytes() in rows for x in made]) < 0.05  # a piece may fit as it was
    assert made.min() >= normal.min()
    assert made.max() <= normal.max()


def test_all_test_scenes_stay_and_the_others_are_anomalies(three):
    whole = load_dataset("digits")
    np.testing.assert_array_equal(three.x_test, whole.x_test)
    np.testing.assert_array_equal(three.y_test, whole.y_test != 3)
    assert three.classes == ("3", "anomaly")
    assert (three.measure, three.chance) == ("AUC", 0.5)


def test_anomalies_are_the_seeds_and_the_origin_makes_them_again(three):
    assert load_dataset("digits", normal="3").hash == three.hash
    assert load_dataset("digits", normal="3", seed=1).hash != three.hash
    assert three.origin is not None
    again = load_dataset(three.origin.data, **three.origin.model_dump(exclude={"data", "view"}))
    assert again.hash == three.hash


@pytest.mark.parametrize("shape", [(20,), (9, 7)])
def test_spectra_and_images_are_changed_alike(shape):
    rng = np.random.default_rng(0)
    scenes = rng.random((40, *shape), dtype=np.float32)
    made = anomalies_of(scenes, rng)
    assert made.shape == scenes.shape
    assert made.dtype == scenes.dtype
    assert (made != scenes).reshape(40, -1).any(axis=1).mean() > 0.9
    pasted = made[:20]  # each value of them is one of the scenes'
    assert np.isin(pasted, scenes).all()


def test_what_cannot_be_is_said_in_one_line(digits):
    with pytest.raises(InputError, match=r"no class '33'.*normal"):
        load_dataset("digits", normal="33")
    x = digits.x_train[:50]
    with pytest.raises(InputError, match="has values and no classes"):
        one_class(load_dataset((x, x.mean(axis=1))), "3")
