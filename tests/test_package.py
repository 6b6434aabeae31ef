"""The package as a program of one's own sees it: names, keywords, errors and words."""

import ast
import inspect
import re
import string
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import torch

import deepfsi
import shared.commands
from conftest import RECIPE, quick, same
from deepfsi.base import Progress, progress_bar
from deepfsi.jobs import Job, Training
from deepfsi.jobs.training import TUNED
from shared.jobs import learn

BRIEF = {**RECIPE, "photons": 1e4, "masks": 5, "device": "cpu"}
SOURCE = Path(deepfsi.__file__).parent


OPTIONS = set().union(*shared.commands.OPTIONS.values())


def test_learn_takes_the_fields_of_a_job_and_its_words_name_each():
    keywords = inspect.signature(deepfsi.learn).parameters
    own = {"data", "counts", "matrix", "start", "device", "report", "checkpoint", "callback"}
    own |= {"patience", "optimiser", "schedule"}
    assert set(keywords) == own | set(Job.model_fields)
    assert all(f"\n    {name} : " in deepfsi.learn.__doc__ for name in keywords)
    assert all(
        keywords[name].default == Job.model_fields[name].default for name in ("design", "seed")
    )
    assert {name for own in TUNED.values() for name in own} <= set(Training.model_fields)


@pytest.mark.parametrize("name", sorted({*deepfsi.__all__} - {"InputError"}))
def test_no_public_callable_hides_its_keywords(name):
    kinds = {each.kind for each in inspect.signature(getattr(deepfsi, name)).parameters.values()}
    assert inspect.Parameter.VAR_KEYWORD not in kinds


def test_the_package_says_that_it_is_typed():
    assert files("deepfsi").joinpath("py.typed").is_file()


def test_settings_that_are_not_given_are_those_tuned_for_the_design(digits):
    brief = {"photons": 1e4, "masks": 64, "epochs": 1, "device": "cpu"}
    tuned = learn(digits, design="raster", **brief).info["job"]["training"]
    assert (tuned["lr"], tuned["scale"]) == (TUNED["raster"]["lr"], "each")
    own = learn(digits, design="raster", lr=1e-3, **brief).info["job"]["training"]
    assert (own["lr"], own["scale"]) == (1e-3, "each")


def test_data_may_be_a_name_or_arrays(digits):
    design = learn("digits", **BRIEF)
    assert same(design, quick(digits, masks=5))
    assert deepfsi.evaluate(design, "digits", 1e4) == deepfsi.evaluate(design, digits, 1e4)
    rng = np.random.default_rng(0)
    x, y = rng.random((60, 4, 4)), np.arange(60) % 2
    assert learn((x, y), **BRIEF).image_shape == (4, 4)
    assert learn((torch.from_numpy(x), torch.from_numpy(y)), **BRIEF).masks == 5


@pytest.mark.parametrize("data", [[1, 2], np.zeros((3, 4)), None, 7])
def test_data_of_another_kind_says_what_to_give(data):
    with pytest.raises(deepfsi.InputError, match="give a Dataset of deepfsi, a name") as error:
        learn(data, **BRIEF)
    assert "\n" not in str(error.value)


def test_a_design_shows_itself_in_one_line(made):
    design = made("deepfsi", "free-dwell", "dual")
    assert repr(design) == (
        "<Design deepfsi: 7 masks of 8x8, free-dwell, dual rails, mlp-8, 10 classes, "
        "learned at 10000 photons>"
    )


def test_a_bar_is_shown_where_a_terminal_is_attached(digits, capsys, monkeypatch):
    deepfsi.evaluate(learn(digits, **BRIEF), digits, 1e4)
    assert capsys.readouterr().err == ""
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich's word for a terminal
    design = learn(digits, **BRIEF)
    assert "deepfsi, 5 masks" in capsys.readouterr().err
    deepfsi.evaluate(design, digits, 1e4)
    assert "deepfsi, 5 masks" in capsys.readouterr().err
    seen = []
    with progress_bar(Progress(lambda share, _: seen.append(share)), "work") as report:
        report(0.5)
    assert seen == [0.5]
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("folder", ["datasets", "design", "optics", "training"])
def test_errors_of_the_library_name_no_option_of_the_command_line(folder):
    found = []
    for path in sorted((SOURCE / folder).rglob("*.py")):
        tree = ast.parse(path.read_text())
        said = [node for node in ast.walk(tree) if isinstance(node, ast.Raise)]
        texts = [n.value for each in said for n in ast.walk(each) if isinstance(n, ast.Constant)]
        found += [text for text in texts if isinstance(text, str) and "--" in text]
    assert not found


def templates() -> list[tuple[str, ast.Call]]:
    """Messages and errors of the package that name settings, each with its module."""
    found = []
    for path in sorted(SOURCE.rglob("*.py")):
        calls = [
            node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)
        ]
        found += [
            (path.name, call)
            for call in calls
            if ast.unparse(call.func) in ("InputError", "Message")
            and (path.name != "errors.py" and call.keywords)
        ]
    return found


def test_each_field_of_a_template_is_a_setting_or_a_value():
    """And a template is no f-string, in which braces of a path would be fields."""
    for module, call in templates():
        said = f"{module}:{call.lineno}"
        given = {keyword.arg: keyword.value for keyword in call.keywords}
        texts = [part for part in ast.walk(call.args[0]) if isinstance(part, ast.Constant)]
        assert not any(isinstance(part, ast.JoinedStr) for part in ast.walk(call.args[0])), said
        fields = set()
        for text in (part.value for part in texts if isinstance(part.value, str)):
            for _, field, spec, _ in string.Formatter().parse(text):
                fields |= {field} if field else set()
                fields |= {
                    inner for _, inner, _, _ in string.Formatter().parse(spec or "") if inner
                }
        setting = given.pop("setting", ast.Constant(()))
        if isinstance(setting, ast.Name):  # a variable
            settings = {"setting"}
        else:
            value = ast.literal_eval(setting)
            settings = {value} if isinstance(value, str) else set(value)
            assert {f"--{name.replace('_', '-')}" for name in settings} <= OPTIONS, said
        assert fields == settings | set(given), said


def test_settings_are_named_in_templates_alone():
    """Not in backticks: the command line would show them so."""
    found = []
    for path in sorted(SOURCE.rglob("*.py")):
        tree = ast.parse(path.read_text())
        docs = {id(n.value) for n in ast.walk(tree) if isinstance(n, ast.Expr)}
        helps = [
            node
            for node in ast.walk(tree)
            if isinstance(node, ast.Call)
            and ast.unparse(node.func) in ("typer.Option", "typer.Argument", "Field", "argument")
        ]
        docs |= {id(n) for each in helps for n in ast.walk(each)}
        texts = [n for n in ast.walk(tree) if isinstance(n, ast.Constant) and id(n) not in docs]
        for text in texts:
            names = re.findall(r"`([a-z_]+)`", text.value) if isinstance(text.value, str) else ()
            found += [name for name in names if f"--{name.replace('_', '-')}" in OPTIONS]
    assert not found


def test_settings_are_options_in_an_error_of_a_command(made, refuse, tmp_path_factory):
    file = made("deepfsi", "column", "dual").save(tmp_path_factory.mktemp("d") / "a.safetensors")
    assert "--nested" in refuse("evaluate", file, "--photons", "1e3", "--first", "3")
