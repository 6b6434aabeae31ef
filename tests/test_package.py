"""The package as a program of one's own sees it: names, keywords, errors and words."""

import inspect
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch

import deepfsi
from conftest import RECIPE, quick, same
from deepfsi.base.progress import Progress, progress_bar
from deepfsi.jobs.job import Job
from deepfsi.jobs.training import TUNED, Training
from shared.jobs import learn

BRIEF = {**RECIPE, "photons": 1e4, "masks": 5, "device": "cpu"}
SOURCE = Path(deepfsi.__file__).parent


def test_learn_takes_the_fields_of_a_job_and_its_words_name_each():
    keywords = inspect.signature(deepfsi.learn).parameters
    own = {"data", "counts", "matrix", "device", "report", "checkpoint", "callback"}
    assert set(keywords) == own | set(Job.model_fields)
    assert all(f"\n    {name} : " in deepfsi.learn.__doc__ for name in keywords)
    for name in ("design", "seed"):
        assert keywords[name].default == Job.model_fields[name].default
    assert {name for tuned in TUNED.values() for name in tuned} <= set(Training.model_fields)


def test_public_callables_show_their_keywords_and_the_package_its_types():
    for name in {*deepfsi.__all__} - {"InputError"}:
        given = inspect.signature(getattr(deepfsi, name)).parameters.values()
        others = {each.name for each in given if each.kind is inspect.Parameter.VAR_KEYWORD}
        assert others <= {"settings"}, name  # fields of the camera
    assert files("deepfsi").joinpath("py.typed").is_file()


def test_settings_that_are_not_given_are_those_tuned_for_the_design(digits):
    brief = {"photons": 1e4, "masks": 64, "epochs": 1, "device": "cpu", "design": "raster"}
    for given, lr in (({}, TUNED["raster"]["lr"]), ({"lr": 1e-3}, 1e-3)):
        training = learn(digits, **brief, **given).info["job"]["training"]
        assert (training["lr"], training["scale"]) == (lr, "each")


def test_data_may_be_a_name_or_arrays(digits):
    design = learn("digits", **BRIEF)
    assert same(design, quick(digits, masks=5))
    assert deepfsi.evaluate(design, "digits", 1e4) == deepfsi.evaluate(design, digits, 1e4)
    x, y = np.random.default_rng(0).random((60, 4, 4)), np.arange(60) % 2
    assert learn((x, y), **BRIEF).image_shape == (4, 4)
    assert learn((torch.from_numpy(x), torch.from_numpy(y)), **BRIEF).masks == 5


def test_a_bar_is_shown_where_a_terminal_is_attached(digits, capsys, monkeypatch):
    def shown():
        deepfsi.evaluate(design, digits, 1e4)
        return capsys.readouterr().err

    design = learn(digits, **BRIEF)
    assert shown() == ""
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich's word for a terminal
    assert "deepfsi, 5 masks" in shown()
    learn(digits, **BRIEF)
    assert "deepfsi, 5 masks" in capsys.readouterr().err
    shares = []
    with progress_bar(Progress(lambda share, _: shares.append(share)), "work") as report:
        report(0.5)
    assert (shares, capsys.readouterr().err) == ([0.5], "")
