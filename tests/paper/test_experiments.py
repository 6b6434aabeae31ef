"""The paper's experiments, run small, and the arithmetic of their claims."""

import csv
import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from deepfsi.base.errors import InputError
from deepfsi.report.accuracy import accuracy_figure
from deepfsi.report.masks import masks_figure
from deepfsi_paper import experiment, mlgauss, studies
from deepfsi_paper.indian_pines import claims as indian_pines
from deepfsi_paper.mnist import accuracy as mnist
from deepfsi_paper.report import section as section_module
from deepfsi_paper.report.study_page import write_study
from shared.experiments import EVERY, run_all
from shared.pages import assert_headed, assert_whole
from shared.results import a_point, make_results, of_three, some_results


@pytest.fixture(scope="module")
def folder(tmp_path_factory, all_drawn_once):
    """Folder in which all experiments have been run, with one trial or with two."""
    with pytest.MonkeyPatch.context() as patch:  # the page and the tests share the sections
        patch.setattr(experiment.Experiment, "section", cache(experiment.Experiment.section))
        yield run_all(tmp_path_factory.mktemp("all"))


def table(path):
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.mark.slow
def test_every_experiment_ends_in_a_section(folder):
    page = studies.page(folder).read_text("utf-8")
    assert_headed(page)
    for each in EVERY:
        section = each.section(folder)
        for number in range(1, len(section.pictures) + 1):
            assert (folder / f"figures/{each.name}-{number}.png").is_file()
        assert section.title in page
        assert section.pictures
        assert section.claims
        assert all(claim.holds in (True, False, None) for claim in section.claims)
        assert all(claim.measured for claim in section.claims)
        assert all(claim.reason for claim in section.claims if claim.holds is None)
        assert "nan" not in section.found
        for rows in (table(folder / name) for name in section.files):
            assert rows
            assert all(0 <= float(row["accuracy"]) <= 1 for row in rows)


@pytest.mark.slow
def test_experiments_share_what_they_train(folder):
    """MLGauss and quantisation test the designs of the comparison: two trainings each at most."""
    made = {path.stem for path in (folder / "designs").glob("*.safetensors")}
    assert len(made) < len(list((folder / "trials").glob("*.json")))


def test_a_folder_without_experiments_is_refused(tmp_path):
    with pytest.raises(InputError, match="deepfsi reproduce"):
        studies.page(tmp_path)


LEVEL = {
    "impulse": 0.95,
    "deepfsi": 0.9,
    "pca": 0.8,
    "truncated-hadamard": 0.7,
    "control": 0.6,
    "hadamard": 0.5,
    "raster": 0.5,
}
OTHER = {("poisson", "truncated-hadamard"): 0.5, ("gaussian", "hadamard"): 0.6}
"""Accuracies that make the paper's claims true; those of one noise."""


def answers(changed):
    """Answers to the claims of the comparison, as the paper has it or with changes."""
    points = [
        of_three(
            changed.get((noise, design, photons), OTHER.get((noise, design), level)),
            noise=noise, design=design, photons=photons,
            throughput=1.0 if design == "hadamard" else 0.45,
        )
        for noise in ("poisson", "gaussian")
        for photons in (1e2, 1e4, 1e8)
        for design, level in LEVEL.items()
        if (noise, design) != ("gaussian", "control")
    ]  # fmt: skip
    results = some_results(points)
    photon, read = (experiment.best(results, noise=noise) for noise in ("poisson", "gaussian"))
    return [claim.holds for claim in (*mnist.photon_claims(photon), *mnist.read_claims(read))]


@pytest.mark.parametrize(
    ("change", "half", "answer"),
    [(0.0, 0.001, True), (-0.01, 0.001, True), (-0.01, 0.01, None), (-0.05, 0.001, False)],
)
def test_mlgauss_is_good_in_bright_light_only_where_intervals_say_so(change, half, answer):
    """Exact counts change accuracy by `change` at 10⁴ photons."""
    points = []
    for noise, masks, photons in itertools.product(
        ("ml_gauss", "poisson"), (10, 92), (1e2, 1e4, 1e6)
    ):
        exact = noise == "poisson"
        accuracy = 0.5 + change * (exact and photons == 1e4)
        accuracies = tuple(accuracy + half * exact * step for step in (-1, 0, 1))
        where = {"noise": noise, "masks": masks, "photons": photons}
        points.append(a_point(accuracy, accuracies=accuracies, **where))
    assert mlgauss.show(some_results(points)).claims[0].holds is answer


@pytest.mark.parametrize(
    ("noise", "design", "photons", "accuracy", "place", "answer"),
    [
        ("poisson", "deepfsi", 1e2, 0.7, 0, False),
        ("poisson", "deepfsi", 1e2, 0.8, 0, None),
        ("poisson", "pca", 1e4, 0.4, 1, False),
        ("poisson", "hadamard", 1e8, 0.6, 2, False),
        ("poisson", "truncated-hadamard", 1e4, 0.6, 3, False),
        ("poisson", "control", 1e4, 0.95, 4, False),
        ("poisson", "deepfsi", 1e8, 0.97, 5, False),
        ("poisson", "pca", 1e4, 0.5, 6, None),
        ("gaussian", "hadamard", 1e4, 0.4, 7, False),
        ("gaussian", "pca", 1e4, 0.95, 8, False),
        ("gaussian", "truncated-hadamard", 1e4, 0.78, 9, False),
        ("gaussian", "pca", 1e2, 0.97, 10, False),
    ],
)
def test_claims_answer_to_the_numbers(noise, design, photons, accuracy, place, answer):
    assert answers({}) == [True] * 11
    assert answers({(noise, design, photons): accuracy})[place] is answer


def test_a_part_and_ratios_take_the_place_of_the_recipes(refuse, tmp_path):
    few = replace(indian_pines.EXPERIMENT, part="random", changes={"ratios": (0.04, 1.0)})
    [(part, recipe)] = few.recipes(quick=False).items()
    assert (part, recipe.ratios, recipe.split) == ("random", (0.04, 1.0), "random")
    out = tmp_path / "out"
    asked = ("reproduce", "indian-pines", "-o", out)
    assert "the parts random, blocks, and rendom" in refuse(*asked, "--part", "rendom")
    assert "--ratios" in refuse(*asked, "--ratios", "a")
    assert "ratios" in refuse(*asked, "--ratios", "2")
    assert "not both" in refuse("reproduce", "ovit", "--ratios", "0.5", "-o", out)
    assert not out.exists()


def test_page_is_one_self_contained_document(tmp_path):
    figures = (accuracy_figure(make_results(tmp_path)), masks_figure(np.eye(4, 16), (4, 4)))
    pictures = tuple(section_module.Picture(each, "words", "words") for each in figures)
    words = dict.fromkeys(("title", "found", "paper", "command"), "words")
    parts = {"pictures": pictures, "claims": (), "tables": (), "files": ("masks 10.csv",)}
    one = section_module.Section(name="one", data="digits", **words, **parts)
    page = write_study(tmp_path / "out", "A study", [one]).read_text("utf-8")
    assert_whole(page, tmp_path / "out", {"masks%2010.csv"})
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"figures", "report.html"}
