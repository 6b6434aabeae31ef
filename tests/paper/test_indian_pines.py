"""The study of spectra: run small on made-up spectra, and claims that answer to made-up numbers."""

import itertools
from dataclasses import asdict

import numpy as np
import pytest

from deepfsi.datasets import catalog
from deepfsi.datasets.catalog import load_indian_pines
from deepfsi.training import learning
from deepfsi_paper import experiment, studies
from deepfsi_paper.indian_pines import claims as indian_pines
from deepfsi_paper.indian_pines import measures
from shared.results import of_three, some_results


def label_map():
    """Sixteen classes in four small fields each, in a scene of Indian Pines' size."""
    labels = np.zeros((145, 145), np.uint8)
    for number, (i, j) in enumerate(itertools.product(range(8), range(8))):
        labels[18 * i + 2 : 18 * i + 6, 18 * j + 2 : 18 * j + 6] = 1 + number % 16
    return labels


def make_home(root, patch):
    """$DEEPFSI_DATA with a small number of made-up spectra in the place of Indian Pines."""
    folder = root / "data" / "indian_pines"
    folder.mkdir(parents=True)
    patch.setenv("DEEPFSI_DATA", str(folder.parent))
    cube = np.random.default_rng(0).integers(955, 2000, (145, 145, 200)).astype(np.uint16)
    cube += (label_map()[..., None] * (100 + np.arange(200))).astype(np.uint16)
    scene = catalog.DATASETS["indian-pines"]
    for stem, values in ((scene.CUBE, cube), ("Indian_pines_gt", label_map())):
        np.save(folder / f"{stem}.npy", values)


@pytest.fixture(scope="module")
def study(tmp_path_factory, all_drawn_once):
    """Run the study with one trial of a moment on made-up spectra: (folder, results, section)."""
    root, whole = tmp_path_factory.mktemp("pines"), experiment.Experiment.recipes
    training = {"epochs": (1,), "batch": (100,), "hidden": ((8,),)}
    changes = {"ratios": (0.02,), "training": training, "draws": 1, "photons": (1e2, 1e4)}

    def recipes(self, quick, trials=None):
        coarse = whole(self, True, trials)
        return {part: recipe.model_copy(update=changes) for part, recipe in coarse.items()}

    with pytest.MonkeyPatch.context() as patch:
        make_home(root, patch)
        patch.setattr(experiment.Experiment, "recipes", recipes)
        patch.setattr(learning, "characterise", lambda *_: None)
        results = indian_pines.EXPERIMENT.run(root / "out", command="deepfsi reproduce", trials=1)
        patch.setattr(experiment.Experiment, "recipes", whole)
        yield root / "out", results, indian_pines.EXPERIMENT.section(root / "out")


def test_both_splits_are_trained_and_tested_apart(study):
    folder, results, section = study
    assert {point.split for point in results.points} == {"random", "blocks"}
    assert len(section.pictures) == 2
    assert "200 bands" in studies.page(folder).read_text()
    keys = {
        split: {key for point in experiment.points(results, split=split) for key in point.keys}
        for split in ("random", "blocks")
    }
    assert len(keys["random"]) == len(keys["blocks"]) > 0
    assert not keys["random"] & keys["blocks"]
    scene = load_indian_pines()
    for split, part in results.extra["parts"].items():
        train, test = scene.parts(split)
        assert (part["train"], part["test"]) == (train.sum(), test.sum())
        assert part["left_out"] == (~train & ~test & (scene.labels > 0)).sum()


LEVEL = {"deepfsi": 0.8, "pca": 0.7, "truncated-hadamard": 0.3, "control": 0.65,
         "hadamard": 0.3, "raster": 0.3, "impulse": 0.9}  # fmt: skip
BUDGETS = (1e2, 1e4, 1e6)


def measured(sizes, *recalls):
    parts = measures.Parts(3, 2, 0, 2)
    return measures.Measures(3, sizes, {"random": parts, "blocks": parts}, recalls)


def answers(changed):
    """Answers to all claims: an advantage under PN, none under AGN, or with changes."""
    points, seen = [], ("pca", "deepfsi", "control")
    for split, noise, photons, design in itertools.product(
        ("random", "blocks"), ("poisson", "gaussian"), BUDGETS, LEVEL
    ):
        level = 0.7 if (design, noise) == ("deepfsi", "gaussian") else LEVEL[design]
        level = changed.get(f"{split}|{noise}|{design}|{photons:g}", level)
        point = of_three(level, split=split, noise=noise, photons=photons, design=design, masks=3)
        turned = point.accuracies[:: -1 if (split, design) == ("random", "deepfsi") else 1]
        points.append(point.model_copy(update={"accuracies": turned, "specific": design in seen}))
    recalls = [
        measures.Recall(split, photons, [[rate - 0.001, None], [rate, 0.0]])
        for split, rate in zip(("random", "blocks"), changed.get("recall", (0.9, 0.8)), strict=True)
        for photons in BUDGETS
    ]
    data = {"classes": ("a", "b"), "image_shape": (4,)}
    extra = asdict(measured([2, 3], *recalls))
    results = some_results(points, recipe={"data": "indian-pines"}, data=data, extra=extra)
    return [claim.holds for claim in indian_pines.claims_of(indian_pines.Numbers(results))]


@pytest.mark.parametrize(
    ("place", "change", "answer"),
    [
        (0, {"random|gaussian|deepfsi|10000": 0.8}, False),
        (0, {"random|gaussian|deepfsi|10000": 0.72}, None),
        (1, {"blocks|gaussian|deepfsi|100": 0.8}, False),
        (2, {"random|poisson|raster|100": 0.85}, False),
        (2, {"blocks|poisson|pca|100": 0.85}, True),
        (3, {"blocks|poisson|pca|100": 0.85}, False),
        (4, {"random|poisson|hadamard|100": 0.4}, False),
        (5, {"random|poisson|truncated-hadamard|100": 0.4}, False),
        (6, {"blocks|poisson|hadamard|10000": 0.4}, False),
        (7, {"blocks|poisson|truncated-hadamard|10000": 0.309}, True),
        (8, {"recall": (0.8, 0.9)}, False),
        (8, {"recall": (0.8, 0.8)}, None),
    ],
)
def test_claims_answer_to_the_numbers(place, change, answer):
    assert answers({}) == [True] * 9
    assert answers(change)[place] is answer


def test_leakage_weighs_classes_by_their_share_of_the_scene():
    """A class that one split does not test counts in neither."""
    scene = measured(
        [6, 2, 9],
        measures.Recall("random", 1e4, [[1.0, 0.6, 0.0]]),
        measures.Recall("blocks", 1e4, [[0.5, 0.2, None]]),
    )
    found = indian_pines.leakage(scene)[1e4]
    assert found.random == pytest.approx((6 * 1 + 2 * 0.6) / 8)
    assert found.blocks == pytest.approx((6 * 0.5 + 2 * 0.2) / 8)
    assert found.difference.mean == pytest.approx(found.random - found.blocks)
