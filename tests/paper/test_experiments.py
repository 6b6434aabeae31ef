"""The paper's experiments, run small, and the arithmetic of their claims."""

import csv
import itertools
import json
import shutil
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from conftest import synthetic
from deepfsi.base import InputError
from deepfsi.sweeps import plan_trials
from deepfsi_paper import experiment, mlgauss, studies
from deepfsi_paper.camera import claims as camera
from deepfsi_paper.indian_pines import claims as indian_pines
from deepfsi_paper.mnist import accuracy as mnist
from shared.experiments import ALL, EVERY, OVIT, run_all
from shared.results import a_point, some_results

ONCE = [each for each in EVERY if each.name not in ("hardware", "detectors-cifar10")]
"""Experiments run with one trial: not the camera's, and one of the two alike on digits."""


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """Folder in which those of `ONCE` have been run with one trial."""
    return run_all(tmp_path_factory.mktemp("one"), 1, ONCE)


@pytest.fixture(scope="module")
def two(one, tmp_path_factory):
    """Folder in which all are run with two trials, one of which was there for those of `ONCE`."""
    folder = tmp_path_factory.mktemp("two")
    for part in ("trials", "designs"):
        shutil.copytree(one / part, folder / part)
    return run_all(folder, 2)


@pytest.fixture(params=["one", "two"])
def done(request):
    """Folder in which all experiments have been run, with one trial and with two.

    Figures of one trial are made and not drawn.
    """
    request.getfixturevalue("undrawn" if request.param == "one" else "drawn_once")
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="module", autouse=True)
def shown_once():
    """Let the page and all tests of a folder share its sections."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(experiment.Experiment, "section", cache(experiment.Experiment.section))
        yield


def sections_of(folder):
    return {each: each.section(folder) for each in run_in(folder)}


@pytest.mark.slow
def test_every_experiment_ends_in_a_section(done):
    page = studies.page(done).read_text()
    for each, section in sections_of(done).items():
        for number in range(1, len(section.pictures) + 1):
            assert (done / f"figures/{each.name}-{number}.png").is_file()
        assert section.title in page
        assert section.pictures
        assert section.claims
        assert all(claim.holds in (True, False, None) for claim in section.claims)
        assert all(claim.measured for claim in section.claims)
        assert all(claim.reason for claim in section.claims if claim.holds is None)
        assert "nan" not in section.found


def run_in(folder):
    return EVERY if (folder / f"{camera.EXPERIMENT.name}.json").is_file() else ONCE


def table(path):
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.mark.slow
def test_the_time_of_an_experiment_is_that_of_all_its_parts(done):
    for each in run_in(done):
        rows = table(done / f"{each.name}-trials.csv")
        trained = sum({row["key"]: float(row["seconds"]) for row in rows}.values())
        spent = json.loads((done / f"{each.name}.json").read_text())["provenance"]
        assert spent["training_seconds"] == pytest.approx(trained, abs=0.1)


@pytest.mark.slow
def test_numbers_behind_the_figures_are_there(done):
    for section in sections_of(done).values():
        for name in section.files:
            rows = table(done / name)
            assert rows
            assert all(0 <= float(row["accuracy"]) <= 1 for row in rows)


@pytest.mark.slow
def test_experiments_share_what_they_train(done):
    """MLGauss and quantisation test the designs of the comparison: two trainings each at most."""
    made = {path.stem for path in (done / "designs").glob("*.safetensors")}
    keys = {}
    for each in run_in(done):
        keys[each.name] = {row["key"] for row in table(done / f"{each.name}-trials.csv")}
    records = len(list((done / "trials").glob("*.json")))
    assert len(set.union(*keys.values())) == records
    assert len(made) < records


def test_a_folder_without_experiments_is_refused(tmp_path):
    with pytest.raises(InputError, match="deepfsi reproduce"):
        studies.page(tmp_path)
    assert not studies.is_study(tmp_path)


@pytest.mark.parametrize("each", ALL, ids=lambda each: each.name)
@pytest.mark.parametrize("quick", [False, True])
def test_every_recipe_is_whole_and_takes_a_number_of_trials(each, quick):
    assert all(recipe.trials >= 3 for recipe in each.recipes(quick).values())
    assert all(recipe.trials == 2 for recipe in each.recipes(quick, trials=2).values())


SCENES = {"adaptive": 2500, "images": 2500}
"""Scenes that have as many clusters as a recipe asks for."""

SHAPES = {"indian-pines": (200,), **{each.name: (64, 64) for each in OVIT}}


@pytest.mark.parametrize("each", ALL, ids=lambda each: each.name)
@pytest.mark.parametrize("quick", [False, True])
def test_every_recipe_can_be_planned(each, quick):
    """On scenes of the data's shape."""
    data = synthetic(SHAPES.get(each.name, (32, 32)), SCENES.get(each.name, 120))
    for recipe in each.recipes(quick, trials=1).values():
        trials = plan_trials(recipe.model_copy(update={"validation": 20}), data)
        assert {trial.job.design for trial in trials} == set(recipe.designs)


def comparison(values):
    """Results of a comparison from accuracies by (noise, design, budget), three trials each."""
    points = []
    for (noise, design, photons), accuracy in values.items():
        shifted = (accuracy - 0.001, accuracy, accuracy + 0.001)
        place = {"noise": noise, "design": design, "photons": photons}
        points.append(a_point(accuracy, 0.002, accuracies=shifted, **place))
    return some_results(points)


LEVEL = {
    "impulse": 0.95,
    "deepfsi": 0.9,
    "pca": 0.8,
    "truncated-hadamard": 0.7,
    "control": 0.6,
    "hadamard": 0.5,
    "raster": 0.5,
}


def answers(**changed):
    """Answers to the claims of the comparison, as the paper has it or with changes."""
    values = {
        (noise, design, photons): accuracy
        for noise, photons in itertools.product(("poisson", "gaussian"), (1e2, 1e4, 1e8))
        for design, accuracy in LEVEL.items()
        if (noise, design) != ("gaussian", "control")
    }
    for photons in (1e2, 1e4, 1e8):
        values[("poisson", "truncated-hadamard", photons)] = 0.5
        values[("gaussian", "hadamard", photons)] = 0.6
    for place, accuracy in changed.items():
        noise, design, photons = place.split("|")
        values[(noise, design, float(photons))] = accuracy
    results = comparison(values)
    photon, read = (experiment.best(results, noise=noise) for noise in ("poisson", "gaussian"))
    return [claim.holds for claim in (*mnist.photon_claims(photon), *mnist.read_claims(read))]


def mlgauss_answer(change, half):
    """Answer to MLGauss's claim where exact counts change accuracy by so much at 10⁴ photons."""
    points = []
    for noise, masks, photons in itertools.product(
        ("ml_gauss", "poisson"), (10, 92), (1e2, 1e4, 1e6)
    ):
        moved = change if (noise, photons) == ("poisson", 1e4) else 0.0
        spread = half * np.array([-1, 0, 1]) if noise == "poisson" else np.zeros(3)
        accuracies = tuple(0.5 + moved + spread)
        points.append(
            a_point(0.5 + moved, noise=noise, masks=masks, photons=photons, accuracies=accuracies)
        )
    return mlgauss.show(some_results(points)).claims[0].holds


@pytest.mark.parametrize(
    ("change", "half", "answer"),
    [(0.0, 0.001, True), (-0.01, 0.001, True), (-0.01, 0.01, None), (-0.05, 0.001, False)],
)
def test_mlgauss_is_good_in_bright_light_only_where_intervals_say_so(change, half, answer):
    assert mlgauss_answer(change, half) is answer


def test_claims_hold_where_the_numbers_are_the_papers():
    assert answers() == [True] * 7


@pytest.mark.parametrize(
    ("change", "place", "answer"),
    [
        ({"poisson|deepfsi|1e2": 0.7}, 0, False),
        ({"poisson|deepfsi|1e2": 0.8}, 0, None),
        ({"poisson|deepfsi|1e8": 0.7}, 0, True),
        ({"poisson|pca|1e4": 0.4}, 1, False),
        ({"poisson|hadamard|1e8": 0.6}, 2, False),
        ({"poisson|hadamard|1e8": 0.505}, 2, True),
        ({"poisson|truncated-hadamard|1e4": 0.6}, 3, False),
        ({"poisson|control|1e4": 0.95}, 4, False),
        ({"poisson|control|1e8": 0.95}, 4, True),
        ({"gaussian|hadamard|1e4": 0.4}, 5, False),
        ({"gaussian|pca|1e4": 0.95}, 6, False),
        ({"gaussian|impulse|1e4": 0.99}, 6, True),
    ],
)
def test_claims_answer_to_the_numbers(change, place, answer):
    assert answers(**change)[place] is answer


def test_a_part_and_ratios_take_the_place_of_the_recipes(refuse, tmp_path):
    few = replace(indian_pines.EXPERIMENT, part="random", changes={"ratios": (0.04, 1.0)})
    [(part, recipe)] = few.recipes(quick=False).items()
    assert (part, recipe.ratios, recipe.split) == ("random", (0.04, 1.0), "random")
    out = tmp_path / "out"
    asked = ("reproduce", "indian-pines", "-o", out)
    assert "no part 'rendom'" in refuse(*asked, "--part", "rendom")
    assert "--ratios" in refuse(*asked, "--ratios", "a")
    assert "ratios" in refuse(*asked, "--ratios", "2")
    assert "not both" in refuse("reproduce", "ovit", "--ratios", "0.5", "-o", out)
    assert not out.exists()
