"""Records on disk."""

import json

import pytest

from deepfsi.sweeps.records import Records
from deepfsi.sweeps.results import RESULTS_SCHEMA
from shared.trials import planned, train_trials


def test_a_lock_whose_folder_another_process_takes_away_is_not_taken(digits, tmp_path, monkeypatch):
    """The folder is there when it is made, and gone when it is looked for."""

    def make(*_):
        raise FileExistsError

    records = Records(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("os.mkdir", make)
        assert not records.lock(planned(digits))
    assert records.lock(planned(digits, designs="pca", masks=3))
    records.release_all()


@pytest.fixture
def alone(digits, tmp_path):
    """Give a trial that was trained, and the record of it."""
    trials = planned(digits, designs="pca", masks=3, photons=1e3)
    return trials, *train_trials(trials, digits, tmp_path)


@pytest.mark.parametrize(
    "damage", [{"test": [{}]}, {"key": "0" * 24}, {"schema": RESULTS_SCHEMA - 1, "test": []}]
)
def test_a_record_without_its_numbers_or_of_another_trial_is_none(digits, alone, tmp_path, damage):
    """Its design, if it is of this training, is tested anew and not trained."""
    trials, first = alone
    ([path], [design]) = (list((tmp_path / part).iterdir()) for part in ("trials", "designs"))
    trained = design.stat().st_mtime_ns
    path.write_text(json.dumps({**first, **damage}))
    [again] = train_trials(trials, digits, tmp_path)
    assert (again["key"], again["test"]) == (first["key"], first["test"])
    assert (design.stat().st_mtime_ns == trained) or "schema" not in damage


@pytest.mark.parametrize(
    ("folder", "left"),
    [("trials", None), ("designs", None), ("trials", '{"key":'), ("trials", "null")],
)
def test_what_is_lost_or_damaged_is_made_again(digits, alone, tmp_path, folder, left):
    trials, first = alone
    (path,) = (tmp_path / folder).iterdir()
    path.write_text(left) if left else path.unlink()
    (again,) = train_trials(trials, digits, tmp_path)
    assert again["key"] == first["key"]
    assert len(list(tmp_path.glob("*/*"))) == 2
