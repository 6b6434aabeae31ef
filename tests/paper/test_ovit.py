"""The study of the vision transformer: its trials, what they leave on disk, and its claims."""

import csv
import re
from dataclasses import replace

import numpy as np
import pytest

from conftest import synthetic
from deepfsi import learn
from deepfsi.base import InputError
from deepfsi.report import accuracy_figure
from deepfsi.report.comparison_page import page_text
from deepfsi.report.style import Figures
from deepfsi.sweeps import Recipe, Workers, batch, compare, plan_trials
from deepfsi_paper import experiment, studies
from deepfsi_paper.ovit import claims as ovit
from deepfsi_paper.ovit.claims import EXPERIMENT, IMAGES
from shared.experiments import OVIT
from shared.results import a_point, some_results

TINY = Recipe(
    data="synthetic",
    folds=1,
    validation=24,
    masks=16,
    designs=("impulse", "raster", "hadamard", "pca", "deepfsi"),
    photons=(1e2, 1e5),
    trials=2,
    draws=1,
    camera="paper",
    exposure={"patch": 4},
    training={
        "epochs": 1,
        "batch": 24,
        "scale": "common",
        "classifier_arguments": {"width": 8, "heads": 2, "depth": 1, "hidden": 8},
    },
)


@pytest.fixture
def images(monkeypatch):
    """Make the study one of small synthetic images, of a moment."""
    data = synthetic((8, 8))
    monkeypatch.setattr(experiment, "load_dataset", lambda name, **how: data)

    def recipes(self, quick, trials=None):
        return {"ovit": TINY if trials is None else TINY.model_copy(update={"trials": trials})}

    monkeypatch.setattr(experiment.Experiment, "recipes", recipes)
    return data


def table(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def test_a_study_ends_in_a_page_with_figures_and_claims(images, tmp_path):
    results = EXPERIMENT.run(tmp_path, command="deepfsi reproduce ovit", device="cpu")
    assert len(results.points) == 10
    page = studies.page(tmp_path).read_text()
    section = EXPERIMENT.section(tmp_path)
    assert section.title in page
    assert "applied to every patch" in page
    assert "synthetic in grey" in section.found
    assert [claim.text.split()[3] for claim in section.claims[:3]] == ["RS", "HB", "FSI"]
    assert all(claim.measured for claim in section.claims)
    for number in (1, 2):
        assert (tmp_path / f"figures/ovit-{number}.png").read_bytes().startswith(b"\x89PNG")
    assert len(table(tmp_path / "ovit-trials.csv")) == 20
    assert {row["data"] for row in table(tmp_path / "ovit-trials.csv")} == {"synthetic"}


def test_a_stopped_study_goes_on_where_it_was(images, tmp_path, monkeypatch):
    trained, most = [], 3
    train = batch.train

    def counted(training_set, jobs, *others, **how):
        if len(trained) == most:
            raise KeyboardInterrupt
        trained.extend(jobs)
        return train(training_set, jobs, *others, **how)

    monkeypatch.setattr(batch, "train", counted)
    with pytest.raises(KeyboardInterrupt):
        EXPERIMENT.run(tmp_path, command="deepfsi reproduce ovit", device="cpu")
    assert len(list((tmp_path / "trials").glob("*.json"))) == 3
    assert not list((tmp_path / "designs").glob(".*"))
    most = 31
    EXPERIMENT.run(tmp_path, command="deepfsi reproduce ovit", device="cpu")
    assert len(trained) == 20
    assert len({(job.design, job.photons, job.seed) for job in trained}) == 20
    EXPERIMENT.run(tmp_path, command="deepfsi reproduce ovit", trials=3, device="cpu")
    assert len(trained) == 30


def test_a_study_is_trained_by_the_processes_asked_for(images, tmp_path, monkeypatch):
    """That several train what one does is a law of `sweeps/test_queue.py`."""
    real, asked = experiment.compare, []

    def watched(*given, workers, **named):
        asked.append(workers)
        return real(*given, workers=Workers(1), **named)

    monkeypatch.setattr(experiment, "compare", watched)
    EXPERIMENT.run(tmp_path, command="", trials=1, device="cpu", workers=2)
    assert asked == [Workers(2)]


def test_damaged_results_are_one_clear_line(images, tmp_path):
    (tmp_path / "ovit.json").write_text("{}")
    with pytest.raises(InputError, match="run the experiment again"):
        studies.page(tmp_path)


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("each", OVIT, ids=lambda each: each.name)
def test_every_design_has_as_many_masks_as_a_patch_has_pixels(each, quick):
    """The full bases are those of a patch, too, not of the image."""
    [recipe] = each.recipes(quick).values()
    trials = plan_trials(recipe.model_copy(update={"validation": 24}), synthetic((64, 64)))
    assert {trial.job.design for trial in trials} == set(recipe.designs)
    assert {trial.job.masks for trial in trials} == {64}
    assert {trial.job.camera.light for trial in trials} == {"column"}
    assert len(trials) == len(recipe.designs) * len(recipe.photons) * recipe.trials


def test_a_comparison_of_patches_has_a_page_with_their_masks(tmp_path):
    results, _ = compare(TINY, synthetic((8, 8)), tmp_path, command="deepfsi", device="cpu")
    page = page_text(results, tmp_path / "designs", Figures())
    assert "all 16 masks" in page or "of 16 masks" in page


@pytest.mark.usefixtures("trained_once")
def test_pixels_of_a_patch_that_never_vary_stay_dark():
    """Those of the first column of every patch."""
    data = synthetic((8, 8))
    x = data.x_train.reshape(-1, 2, 4, 2, 4).copy()
    x[..., 0] = 0.5
    still = replace(data, x_train=x.reshape(len(x), -1))
    training = {name: value for name, [value] in TINY.training.items()}
    made = learn(
        still, design="deepfsi", masks=4, photons=1e4, camera="paper", exposure={"patch": 4},
        training=training, device="cpu",
    )  # fmt: skip
    masks = made.matrix.reshape(4, 4, 4)
    assert not masks[..., 0].any()
    assert masks[..., 1:].any(axis=0).all()


@pytest.mark.parametrize(
    ("original", "jpeg", "loaded"),
    [
        ("here", "here", "cifar10"),
        ("here", "not here", "cifar10"),
        ("not here", "here", "cifar10-jpeg"),
        ("not here", "not here", "cifar10"),
    ],
)
def test_the_jpeg_copy_stands_in_only_where_it_must(tmp_path, monkeypatch, original, jpeg, loaded):
    here = {"cifar10": original == "here", "cifar10-jpeg": jpeg == "here"}
    monkeypatch.setattr(experiment, "where", here.get)

    def load(name, **how):
        raise InputError(f"asked for {name}, {how}")

    monkeypatch.setattr(experiment, "load_dataset", load)
    how = {"size": (64, 64), "images": 12_000, "split": None}
    with pytest.raises(InputError, match=re.escape(f"asked for {loaded}, {how}")):
        EXPERIMENT.run(tmp_path, command="")


def results_of(gap: float):
    """Results in which the learned design is ahead of the others by `gap`, with little spread."""
    points = [
        a_point(
            base + step + 0.002,
            photons=photons,
            design=design,
            accuracies=tuple(base + step + seed for seed in (0.0, 0.002, 0.004)),
        )
        for photons, base in ((1e2, 0.2), (1e6, 0.4))
        for design, step in (("deepfsi", gap), ("raster", 0), ("hadamard", 0), ("pca", 0))
    ]
    return {(point.design, point.photons): point for point in points}


@pytest.mark.parametrize(("gap", "holds"), [(0.05, True), (-0.05, False)])
def test_the_claim_follows_from_the_differences(gap, holds):
    claim = ovit.ahead(results_of(gap), "pca", [1e2, 1e6])
    assert claim.holds is holds
    assert "100" in claim.measured
    assert ("not clearly above" in claim.why) is not holds


def test_claims_of_all_images_are_of_five_budgets_and_each_rival():
    [recipe] = IMAGES.recipes(quick=False).values()
    points = [
        a_point(0.3, photons=photons, design=design, accuracies=(0.29, 0.3, 0.31))
        for photons in recipe.photons
        for design in recipe.designs
    ]
    masks = [
        {"photons": photons, "side": 2, "throughput": [1.0, 1.0], "directions": [3.0, 3.1],
         "matrix": np.eye(4).tolist()}
        for photons in recipe.photons
    ]  # fmt: skip
    told = {"recipe": recipe.model_dump(mode="json"), "data": {"image_shape": (64, 64)}}
    claims = IMAGES.show(some_results(points, **told, extra={"masks": masks})).claims
    assert [claim.text.split()[3] for claim in claims[:3]] == ["raster", "hadamard", "pca"]
    assert all(claim.measured.count(" at ") == 5 for claim in claims[:3])
    assert all(claim.holds is None for claim in claims[:3])
    assert "at 100 and" in claims[3].measured
    assert "at 10" in claims[4].measured


@pytest.mark.parametrize(
    ("dim", "bright", "holds"),
    [
        ([0.5, 0.51, 0.52], [0.9, 0.91, 0.92], True),
        ([0.9, 0.901, 0.899], [0.9, 0.9001, 0.8999], False),  # equal, and that is known
        ([0.8, 0.9, 1.0], [0.95, 0.9, 0.85], None),
    ],
)
def test_light_is_spared_only_where_the_difference_can_be_noticed(dim, bright, holds):
    claim = ovit.grows("frugal", [(1e2, dim), (1e6, bright)], ovit.NOTICED, "why not")
    assert claim.holds is holds
    assert (claim.why == "why not") is (holds is False)


def test_names_keep_their_distance_on_a_short_axis():
    points = [
        a_point(0.48, low=0.47, high=0.489, design=design, specific=False, photons=photons)
        for design in TINY.designs
        for photons in (1e4, 1e6)
    ]
    results = some_results(points, data={"classes": ("a", "b")})
    (ax,) = accuracy_figure(results, top=0.5).axes
    assert ax.get_ylim() == (0, 0.5)
    heights = sorted(text.get_position()[1] for text in ax.texts if text.get_text())
    assert heights[-1] < 0.52
    assert np.diff(heights).min() >= 0.029


def test_more_images_are_trained_as_fewer_are():
    [few], [many] = (each.recipes(quick=False).values() for each in (EXPERIMENT, IMAGES))
    assert (many.images, few.images) == (None, 12_000)
    same = ("designs", "photons", "trials", "training", "exposure", "camera", "masks", "size")
    for name in (*same, "draws"):
        assert getattr(many, name) == getattr(few, name)
