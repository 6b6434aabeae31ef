"""Recipes by name and by file."""

from deepfsi.cli import studies


def test_a_recipe_of_the_package_goes_by_its_name_and_a_file_by_its_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mnist").write_text("trials = 7")
    assert studies.read_recipe("mnist")["data"] == "mnist"
    assert studies.read_recipe("./mnist") == {"trials": 7}


def test_a_sweep_by_name(done, tmp_path, monkeypatch):
    """The recipe is found from any folder; what it says is shrunk to a moment."""
    tiny = {"data": "digits", "designs": "pca", "masks": 3, "photons": 1e3, "draws": 1}
    monkeypatch.setattr(studies, "read_toml", lambda file: {**tiny, "training": {"epochs": 1}})
    monkeypatch.chdir(tmp_path)
    done("sweep", "baseline", "--workers", 1)
    assert len(list((tmp_path / "runs" / "sweep" / "trials").iterdir())) == 1
