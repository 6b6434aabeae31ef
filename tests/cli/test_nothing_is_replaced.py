"""What is at --out is replaced with --force, and by nothing else."""

import json

import pytest

from deepfsi import InputError

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


def test_names_of_design_files_end_as_on_the_command_line(good, tmp_path):
    for name in ("digits", "digits.pt", "digits.safetensors.bak"):
        with pytest.raises(InputError, match=r"end the name in \.safetensors"):
            good.save(tmp_path / name)
    assert not any(tmp_path.iterdir())
    assert good.save(tmp_path / "D.SAFETENSORS").is_file()
