"""Laws of the classifier for scikit-learn: its checks, its tools, and the exposures of a design."""

import pickle

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.metrics import classification_report
from sklearn.model_selection import GridSearchCV, GroupKFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import Normalizer
from sklearn.utils.estimator_checks import check_estimator

from deepfsi import DeepFSIClassifier, Design, InputError, evaluate

pytestmark = pytest.mark.usefixtures("trained_once")


def classifier(**settings):
    return DeepFSIClassifier(**{"masks": 4, "epochs": 3, "random_state": 0, **settings})


@pytest.mark.slow
def test_scikit_learns_checks():
    given = classifier(masks=2, epochs=10)
    results = check_estimator(given, on_fail=None, on_skip=None)
    assert len(results) > 50
    assert [each for each in results if each["status"] == "failed"] == []


def test_the_score_is_the_accuracy_of_the_design(digits):
    """Of 360 scenes once here and ten times there, to five deviations."""
    fitted = classifier(masks=8, epochs=10, image_shape=(8, 8)).fit(digits.x_train, digits.y_train)
    names = np.array(digits.classes)
    named = clone(fitted).fit(digits.x_train, names[digits.y_train])
    assert fitted.design_.image_shape == (8, 8)
    [wanted] = evaluate(fitted.design_, digits, 1e4, draws=10)
    deviation = np.sqrt(wanted.accuracy * (1 - wanted.accuracy) * 1.1 / len(digits.y_test))
    assert abs(fitted.score(digits.x_test, digits.y_test) - wanted.accuracy) < 5 * deviation
    assert wanted.accuracy > 0.5
    answers = named.predict(digits.x_test)
    np.testing.assert_array_equal(answers, names[fitted.predict(digits.x_test)])
    report = classification_report(names[digits.y_test], answers, output_dict=True)
    assert {"precision", "recall", "f1-score", "support"} == report["3"].keys()


def test_draws_follow_from_seed_and_scene_and_not_from_the_order(digits, tmp_path):
    fitted = classifier(photons=100).fit(digits.x_train, digits.y_train)
    x = digits.x_test[:50]
    chances = fitted.predict_proba(x)
    np.testing.assert_allclose(chances.sum(axis=1), 1, rtol=1e-6)
    np.testing.assert_array_equal(fitted.predict_proba(x[::-1]), chances[::-1])
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(fitted)).predict_proba(x), chances)
    repeated = fitted.predict_proba(np.repeat(x[:1], 50, axis=0))
    assert len(np.unique(repeated, axis=0)) > 25  # exposures of their own
    np.testing.assert_array_equal(repeated[0], chances[0])
    saved = Design.load(fitted.design_.save(tmp_path / "x.safetensors"))
    assert saved.masks == 4


def test_pipelines_searches_and_groups(digits):
    x, y = digits.x_train[:300], digits.y_train[:300]
    groups = np.arange(300) // 20
    pipeline = make_pipeline(Normalizer("max"), classifier())
    search = GridSearchCV(pipeline, {"deepfsiclassifier__masks": [1, 8]}, cv=GroupKFold(2))
    search.fit(x, y, groups=groups)
    assert search.best_params_ == {"deepfsiclassifier__masks": 8}
    best = search.best_estimator_[-1]
    assert best.get_params()["masks"] == best.design_.masks == 8
    scores = cross_val_score(best, x, y, groups=groups, cv=GroupKFold(3))
    assert scores.shape == (3,)
    assert scores.min() > 0.15  # of ten classes


def test_adaptive_masks_and_a_camera(digits):
    x, y = digits.x_train[:200], digits.y_train[:200]
    given = {"masks": 3, "epochs": None, "random_state": 0}
    adaptive = DeepFSIClassifier(design="adaptive", **given).fit(x, y)
    assert adaptive.score(digits.x_test[:50], digits.y_test[:50]) > 0.3
    camera = {"exposure": "10ms", "flux": 1e6}
    timed = DeepFSIClassifier(None, camera=camera, design="pca", masks=3).fit(x, y)
    assert timed.design_.camera.budget == 1e4
    assert timed.predict(x[:2]).shape == (2,)


def test_values_above_1_are_divided_by_the_brightest_of_the_training(digits):
    x, y = digits.x_train[:200], digits.y_train[:200]
    bright = classifier().fit(8 * x, y)
    assert bright.white_ == 8 * x.max()
    np.testing.assert_array_equal(
        bright.predict_proba(8 * x), classifier().fit(x, y).predict_proba(x)
    )


def test_what_does_not_fit_is_refused(digits):
    with pytest.raises(InputError, match=r"64 pixels do not fit the image shape \(8, 9\)"):
        classifier(image_shape=(8, 9)).fit(digits.x_train, digits.y_train)
    with pytest.raises(ValueError, match="Negative values"):
        classifier().fit(-digits.x_train, digits.y_train)
