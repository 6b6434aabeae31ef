"""What is at --out is replaced with --force, and by nothing else."""

import json

import pytest

from deepfsi import Design, InputError

DESIGN = ("design", "--photons", "1e3", "--masks", 3, "--epochs", 1)
COMPARE = ("compare", "--photons", "1e3", "--trials", 1, "--epochs", 1, "--designs", "pca")


def test_a_design_is_replaced_with_force_only(done, refuse, tmp_path):
    out = tmp_path / "d.safetensors"
    out.write_text("no design")
    assert "exists already: give another name, or --force" in refuse(*DESIGN, "-o", out)
    assert out.read_text() == "no design"
    done(*DESIGN, "--seed", 1, "-o", out, "--force")
    assert Design.load(out).info["job"]["seed"] == 1


def test_results_are_never_lost_to_those_of_other_settings(done, refuse, tmp_path):
    out = tmp_path / "out"
    done(*COMPARE, "--masks", 3, "-o", out)
    before = (out / "results.json").read_bytes()
    done(*COMPARE, "--masks", 3, "-o", out)
    for other in ("--masks 4", "--masks 3 --camera two-arm", "--masks 3 --hidden 9"):
        told = refuse(*COMPARE, *other.split(), "-o", out)
        assert f"{out} holds results of other settings (" in told
        assert "--force to replace its results" in told
    done(*COMPARE, "--masks", "3,4", "-o", out)
    points = json.loads((out / "results.json").read_bytes())["points"]
    assert {point["masks"] for point in points} == {3, 4}, "more settings lose nothing"
    assert "holds results" in refuse(*COMPARE, "--masks", 3, "-o", out)
    done(*COMPARE, "--masks", 3, "-o", out, "--force")
    again = (out / "results.json").read_bytes()
    keys = [json.loads(text)["points"][0]["keys"] for text in (before, again)]
    assert keys[0] == keys[1]
    (out / "results.json").write_text("{}")
    assert "--force replaces it" in refuse(*COMPARE, "--masks", 3, "-o", out)


def test_names_of_design_files_end_as_on_the_command_line(good, tmp_path):
    for name in ("digits", "digits.pt", "digits.safetensors.bak"):
        with pytest.raises(InputError, match=r"end the name in \.safetensors"):
            good.save(tmp_path / name)
    assert not any(tmp_path.iterdir())
    assert good.save(tmp_path / "D.SAFETENSORS").is_file()
