"""What is at --out is replaced with --force, and by nothing else."""

import json

COMPARE = ("compare", "--photons", "1e3", "--trials", 1, "--epochs", 1, "--designs", "pca")


def test_other_settings_in_a_folder_lose_no_training(done, tmp_path):
    """The results are those of the last command; records and designs of others stay."""
    out = tmp_path / "out"
    done(*COMPARE, "--masks", 3, "-o", out)
    before = json.loads((out / "results.json").read_bytes())
    done(*COMPARE, "--masks", 4, "-o", out)
    assert len([*(out / "trials").iterdir()]) == 2
    done(*COMPARE, "--masks", 3, "-o", out)
    again = json.loads((out / "results.json").read_bytes())
    assert again["points"] == before["points"]
