"""Options made from fields: one for each, with the field's text, and none that is written twice."""

import json
from collections import Counter

import pytest

from deepfsi.camera import Camera
from deepfsi.cli.fields import NO_OPTIONS
from deepfsi.jobs import EXPOSURE_KINDS, SETTING_ALIASES, Job, Training
from shared.commands import COMMANDS

OWN = {"design", "masks", "photons", "camera", "seed"}
RANGED = {"span"}  # a range of budgets is given as --photons LOW:HIGH
OF_COMMANDS = {"design": set(), "compare": {"design", "seed"}, "plan": {"design", "seed"}}


def declared() -> dict[str, str]:
    """Name of the option and text of every field of a job."""
    names = {place: name for name, place in SETTING_ALIASES.items()}
    tables = {"camera": Camera.model_fields, "training": Training.model_fields}
    found = {name: Job.model_fields[name].description for name in OWN}
    found |= {
        n: kind.model_fields[n].description for n, kind in EXPOSURE_KINDS.items() if n not in RANGED
    }
    for table, fields in tables.items():
        for name, field in fields.items():
            if name not in NO_OPTIONS:
                found[names.get((table, name), name)] = field.description
    return found


@pytest.mark.parametrize("command", OF_COMMANDS)
def test_every_field_has_one_option_with_its_text(command):
    declared_options = COMMANDS[command].declared
    count = Counter(option for each in declared_options for option in each.names)
    assert set(count.values()) == {1}
    texts = {each.names[0]: each.field.description for each in declared_options}
    for name, text in declared().items():
        if name not in OF_COMMANDS[command]:
            assert texts[f"--{name.replace('_', '-')}"].startswith(text)


@pytest.mark.parametrize("command", OF_COMMANDS)
def test_options_stand_under_headings_those_that_most_need_first(done, command):
    out = done(command, "--help")
    heads = [line for line in out.splitlines() if line.endswith(":") and line[0] != " "]
    assert heads == ["Options:", "Camera:", "Exposure:", "Training:"]
    assert out.index("--masks") < out.index("--size") < out.index("--light") < out.index("--epochs")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--photons abc --masks 3", "--photons: 'abc' is not a number"),
        ("--photons 1e3 --masks 0", "masks = 0: give 1 or more"),
        ("--masks 3", "photons"),
        ("--photons 1e3 --masks 3 --light colum", "light = 'colum'"),
        ("--photons 1e3 --masks 3 --camera nofile.toml", "nofile.toml is missing: give a"),
        ("--photons 1e3 --masks 3 --camera papr", "did you mean 'paper'"),
        ("--photons 1e3 --masks 3 --camera key.toml", "key.toml has an unknown key 'lihgt'"),
        ("--photons 1e3 --masks 3 --camera unit.toml", "unit.toml cannot be used at exposure"),
        ("--photons 1e3 --masks 3 --looks 3 --nested 2", "nested and looks are of different"),
        ("--photons 1e3 --masks 3 --light two-arm --rails single", "use dual rails"),
        ("--photons 1e3 --masks 3 --dmd dlp7000 --light column", "device"),
        ("--photons 1e3 --masks 3 --sigma 2", "--sigma is not of poisson noise: leave it out"),
    ],
)
def test_what_cannot_be_is_one_line_that_names_it(refuse, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "key.toml").write_text('lihgt = "column"\n')
    (tmp_path / "unit.toml").write_text('exposure = "10 parsec"\n')
    before = sorted(tmp_path.iterdir())
    assert said in refuse("design", *words.split(), "-o", "out.safetensors")
    assert sorted(tmp_path.iterdir()) == before


def test_optics_are_axes_of_a_comparison(done, tmp_path):
    """Layers of a network are no axis, and numbers are numbers in what is written."""
    words = "--designs pca --photons 1e3 --masks 3 --trials 1 --epochs 1 --hidden 8,4 --workers 1"
    axes = ("--light", "column,free-dwell", "--rails", "dual,single")
    told = json.loads(done("compare", *words.split(), *axes, "-o", tmp_path / "out", "--json"))
    assert {(point["light"], point["rails"]) for point in told["points"]} == {
        (light, rails) for light in ("column", "free-dwell") for rails in ("dual", "single")
    }
    assert told["recipe"]["training"] == {"epochs": [1], "hidden": [[8, 4]]}
