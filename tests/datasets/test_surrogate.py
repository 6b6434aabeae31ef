"""The simulated Indian Pines is determined, and its physics shows."""

import os
from pathlib import Path

import numpy as np
import pytest
from dataset_samples import NM, fields

from deepfsi.datasets import indian_pines, surrogate

REAL = Path(os.environ.get("DEEPFSI_DATA") or ".") / "indian_pines"

real_labels = pytest.mark.skipif(
    not all((REAL / file).is_file() for file in ("Indian_pines_gt.mat", "92AV3C.spc")),
    reason="needs the label map and band table in $DEEPFSI_DATA/indian_pines",
)


def test_the_simulated_scene_is_determined():
    labels = fields(40, 16)
    first, again, other = (surrogate.simulate(labels, NM, seed) for seed in (1, 1, 2))
    assert first.dtype == np.uint16
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_names_of_the_classes_agree():
    assert tuple(surrogate.CLASSES) == indian_pines.CLASSES


CROPS = ("Corn", "Soyb")

LIVE = np.r_[0:103, 108:149, 163:219]  # bands that the air lets through


@pytest.fixture(scope="module")
def scene():
    """The simulated scene on the real label map."""
    return indian_pines.load_scene("indian-pines-surrogate")


@real_labels
def test_counts_and_values(scene):
    data = scene.dataset(bands=256)
    assert len(data.x_train) + len(data.x_test) == 10_249
    counts = np.bincount(np.r_[data.y_train, data.y_test])
    assert counts[[0, 8, 10]].tolist() == [46, 20, 2455]
    assert 900 < scene.cube.min() < 1000, "the published values begin at 955"
    assert 7000 < scene.cube.max() < 11_000, "and end at 9604"


def radiance(scene, name, low, high):
    """Mean radiance above the offset, of a class between two wavelengths."""
    assert scene.wavelengths is not None
    bands = (scene.wavelengths > low) & (scene.wavelengths < high)
    label = indian_pines.CLASSES.index(name) + 1
    return float(scene.cube[scene.labels == label][:, bands].mean(dtype=float)) - 1000


@real_labels
def test_the_physics_shows(scene):
    for name in indian_pines.CLASSES:
        for low, high in ((1370, 1400), (1860, 1900)):
            assert abs(radiance(scene, name, low, high)) < 20, "water vapour is opaque"
        assert radiance(scene, name, 930, 950) < 0.6 * radiance(scene, name, 860, 890)
    for name in ("Woods", "Grass-pasture", "Alfalfa"):
        red, green = (radiance(scene, name, *b) for b in ((660, 685), (545, 565)))
        infrared = radiance(scene, name, 780, 800)
        assert infrared > 2 * red, "the red edge"
        assert green > red
    soil = radiance(scene, "Soybean-clean", 780, 800) / radiance(scene, "Soybean-clean", 660, 685)
    assert soil < 2
    leaf_water, dry = (
        radiance(scene, name, 1640, 1660) / radiance(scene, name, 1070, 1080)
        for name in ("Woods", "Soybean-clean")
    )
    assert leaf_water < dry


@real_labels
def test_neighbours_resemble_each_other(scene):
    band = scene.cube[..., 40].astype(float)
    woods = scene.labels == 14
    inside = woods[:, :-1] & woods[:, 1:]
    left, right = band[:, :-1][inside], band[:, 1:][inside]
    assert np.corrcoef(left, right)[0, 1] > 0.5
    shuffled = np.random.default_rng(0).permutation(right)
    assert abs(np.corrcoef(left, shuffled)[0, 1]) < 0.1


@real_labels
def test_classes_are_as_hard_as_in_the_real_scene(scene):
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
    from sklearn.metrics import confusion_matrix
    from sklearn.neighbors import KNeighborsClassifier

    def accuracy(model, split, seed):
        data = scene.dataset(split, seed)
        x, x_test = data.x_train[:, LIVE], data.x_test[:, LIVE]
        return float((model.fit(x, data.y_train).predict(x_test) == data.y_test).mean())

    linear, nearest = LinearDiscriminantAnalysis(), KNeighborsClassifier(1)
    assert 0.7 < accuracy(linear, "random", 0) < 0.9
    random = accuracy(nearest, "random", 0)
    blocks = np.mean([accuracy(nearest, "blocks", seed) for seed in range(3)])
    assert random > blocks + 0.05, "neighbours leak"

    data = scene.dataset()
    guess = linear.fit(data.x_train[:, LIVE], data.y_train).predict(data.x_test[:, LIVE])
    wrong = confusion_matrix(data.y_test, guess)
    np.fill_diagonal(wrong, 0)
    crops = [indian_pines.CLASSES.index(c) for c in indian_pines.CLASSES if c[:4] in CROPS]
    assert wrong[np.ix_(crops, crops)].sum() > 0.5 * wrong.sum(), "corn and soybeans"
