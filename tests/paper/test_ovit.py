"""The study of the vision transformer: its trials, what they leave on disk, and its claims."""

import pytest

from conftest import synthetic
from deepfsi.sweeps.recipe import Recipe
from deepfsi_paper import experiment, studies
from deepfsi_paper.ovit import claims as ovit
from shared.results import of_three

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
def images(monkeypatch, trained_once):
    """Make the study one of small synthetic images, of a moment."""
    data = synthetic((8, 8))
    monkeypatch.setattr(experiment, "load_dataset", lambda name, **how: data)

    def recipes(self, quick, trials=None):
        return {"ovit": TINY if trials is None else TINY.model_copy(update={"trials": trials})}

    monkeypatch.setattr(experiment.Experiment, "recipes", recipes)
    return data


@pytest.mark.usefixtures("uncharacterised")
def test_a_study_ends_in_a_page_with_figures_and_claims(images, tmp_path):
    results = ovit.EXPERIMENT.run(tmp_path, command="deepfsi reproduce ovit", device="cpu")
    assert len(results.points) == 10
    page = studies.page(tmp_path).read_text()
    section = ovit.EXPERIMENT.section(tmp_path)
    assert section.title in page
    assert [claim.text.split()[3] for claim in section.claims[:3]] == ["RS", "HB", "FSI"]
    assert all(claim.measured for claim in section.claims)
    for number in (1, 2):
        assert (tmp_path / f"figures/ovit-{number}.png").read_bytes().startswith(b"\x89PNG")
    assert results.data.name == "synthetic"


def results_of(gap: float):
    """Results in which the learned design is ahead of the others by `gap`, with little spread."""
    points = [
        of_three(base + step, photons=photons, design=design)
        for photons, base in ((1e2, 0.2), (1e6, 0.4))
        for design, step in (("deepfsi", gap), ("pca", 0))
    ]
    return {(point.design, point.photons): point for point in points}


@pytest.mark.parametrize(("gap", "holds"), [(0.05, True), (-0.05, False)])
def test_the_claim_follows_from_the_differences(gap, holds):
    claim = ovit.ahead(results_of(gap), "pca", [1e2, 1e6])
    assert claim.holds is holds
    assert "100" in claim.measured
    assert ("not clearly above" in claim.why) is not holds


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
