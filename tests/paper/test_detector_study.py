"""The study of detectors answers to the numbers."""

from itertools import product
from types import SimpleNamespace

import pytest

from deepfsi_paper import detectors as study
from deepfsi_paper import experiment
from shared.results import of_three, some_results

LIGHTS = (1e2, 1e3, 1e4, 1e5)
NAMES = ("1x1", "2x2", "4x4", "8x8")
ACCURACY = {  # by photons, a column for each number of detectors, the last that of each pixel
    1e2: (0.20, 0.30, 0.40, 0.45, 0.53),
    1e3: (0.48, 0.70, 0.80, 0.88, 0.93),
    1e4: (0.85, 0.95, 0.97, 0.98, 0.985),
    1e5: (0.97, 0.97, 0.97, 0.97, 0.97),
}


def point(recipe, name, photons, accuracy, **fields):
    optics = {"light": "free-dwell", "rails": "single", "detectors": name, "masks": 4}
    return of_three(accuracy, recipe=recipe, **{**optics, "photons": photons, **fields})


def results(bare=-0.1, **changed):
    """Results with another accuracy at PLACE (place of the detectors) and PHOTONS.

    `bare` is what a frame that is all ON reads more than masks.
    """
    points = []
    for photons, place in product(LIGHTS, range(4)):
        accuracy = changed.get(f"at_{place}_{photons:g}", ACCURACY[photons][place])
        points.append(point(NAMES[place], NAMES[place], photons, accuracy))
        points.append(point(NAMES[place], NAMES[place], photons, 0.99, masks=8, best=False))
    without = {"design": "truncated-hadamard", "masks": 1}
    for photons, (place, name) in product(LIGHTS, enumerate(("2x2", "4x4", "16x16"), 1)):
        points.append(point("on", name, photons, ACCURACY[photons][place] + bare, **without))
    for photons in LIGHTS:
        impulse = {"design": "impulse", "light": "column", "masks": 1024, "ratio": 1.0}
        points.append(point("impulse", "1x1", photons, ACCURACY[photons][-1], **impulse))
    return some_results(points)


@pytest.mark.parametrize(
    ("changes", "answers"),
    [
        ({}, [True] * 7),
        ({"at_1_1000": 0.65}, [False, *[True] * 6]),
        ({"at_1_10000": 0.939}, [True, None, *[True] * 5]),
        ({"at_3_10000": 0.96}, [*[True] * 4, False, *[True] * 2]),
        ({"at_3_10000": 0.97}, [*[True] * 4, None, *[True] * 2]),
        ({"bare": 0.01}, [*[True] * 5, False, False]),
        ({"bare": 0.0}, [*[True] * 5, None, None]),
    ],
)
def test_claims_answer_to_the_numbers(changes, answers):
    claims = study.MNIST.show(results(**changes)).claims
    assert [claim.holds for claim in claims] == answers
    assert all(claim.measured for claim in claims)
    assert len(study.CIFAR10.show(results(**changes)).claims) == len(answers) - 4


def test_the_start_is_chosen_on_validation_images_and_not_on_those_of_the_test():
    better = {"validation": 0.9, "masks": 12, "variant": "start truncated-hadamard"}
    made = results()
    other = point("2x2", "2x2", 1e3, 0.65, **better)
    for points in ([other, *made.points], [*made.points, other]):
        [table] = study.MNIST.show(made.with_points(points)).tables
        assert table.rows[1][3] == "0.650 (12)"


JPEG = "cifar10-jpeg"


@pytest.mark.parametrize(
    ("here", "taken"), [(("cifar10", JPEG), "cifar10"), ((JPEG,), JPEG), ((), "cifar10")]
)
def test_a_copy_in_jpeg_is_taken_where_the_original_is_not_here(monkeypatch, here, taken):
    found = [SimpleNamespace(name=name, where="a folder") for name in here]
    monkeypatch.setattr(experiment, "list_datasets", lambda: found)
    assert {each.data for each in study.CIFAR10.recipes(True).values()} == {taken}
