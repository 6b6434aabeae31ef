"""What the tests share: small data sets, every design under every constraint, and tolerances.

A statistical tolerance is five standard deviations of the estimator, so that one test in two
million fails by chance; the seeds are fixed, so that it then fails always.
"""

import os
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

os.environ["OMP_NUM_THREADS"] = "1"  # read when numpy and torch are imported, here and in children

import numpy as np
import pytest
import torch
from torch import Tensor

from deepfsi import Dataset, Design, from_arrays, load_dataset
from deepfsi.camera.names import LIGHT_LAWS
from deepfsi.jobs.designs import DESIGNS, count_allowed
from deepfsi.physics.detection import Rails
from deepfsi.physics.laws import light_law
from shared.jobs import learn
from shared.pictures import save_images

PHOTONS = 1e4
FLOAT32 = 2e-6
"""Relative error of a sum of some tens of float32 numbers."""

FIXED = [name for name, code in DESIGNS.items() if code.make is not None]
"""The designs that `coding.sensing_matrix` knows."""

RECIPE = {
    "epochs": 1,
    "batch": 100,
    "lr": 5e-3,
    "mask_lr": 5e-3,
    "hidden": (8,),
    "scale": "each",
    "precision": "float32",
}
"""A training of a moment; spelt out, so that tests do not follow the package's defaults."""

OPTICS = [
    (light, rails)
    for light in LIGHT_LAWS
    for rails in ("dual", "single")
    if (light, rails) != ("two-arm", "single")
]
"""Every light law with the rails it can have."""


def _possible(design: str, light: str, rails: str) -> bool:
    single = DESIGNS[design].rails == "single"
    if design == "hadamard":
        return rails == "dual"
    if rails == "single" and (single or design in ("truncated-hadamard", "lda", "class-pairs")):
        return False  # they have one rail anyhow, or obey as pca does
    return not (design in ("raster", "s-matrix") and light == "two-arm")


CASES = [
    pytest.param(design, light, rails, id=f"{design}-{light}-{rails}")
    for design, code in DESIGNS.items()
    if not code.adaptive
    for light, rails in OPTICS
    if _possible(design, light, rails)
]
"""Designs under the constraints that they can be brought to."""

every_design = pytest.mark.parametrize(("design", "light", "rails"), CASES)
every_passive_design = pytest.mark.parametrize(
    ("design", "light", "rails"), [case for case in CASES if case.values[1] != "dose"]
)
"""Those of scenes that send their light by themselves; a projector can send a pixel more."""

every_optics = pytest.mark.parametrize(("light", "rails"), OPTICS)
real_mnist = pytest.mark.skipif(not os.environ.get("DEEPFSI_DATA"), reason="needs $DEEPFSI_DATA")


def exposing(design: Design, **fields: Any) -> Design:
    """The design with other fields of its exposure."""
    return replace(design, exposure=replace(design.exposure, **fields))


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def synthetic(shape: tuple[int, ...], scenes: int = 120, classes: int = 3) -> Dataset:
    """Noisy copies of one random pattern for each class."""
    rng = np.random.default_rng(5)
    labels = np.arange(scenes) % classes
    patterns = rng.random((classes, *shape))
    x = 0.6 * patterns[labels] + 0.4 * rng.random((scenes, *shape))
    return from_arrays(x, labels, name="synthetic")


def own_matrix(masks: int, pixels: int, light: str, rails: str) -> np.ndarray:
    """A user's matrix that obeys a constraint."""
    rng = np.random.default_rng(3)
    if light == "two-arm":
        return rng.choice([-1.0, 1.0], size=(masks, pixels)) / masks
    wild = rng.random((masks, pixels)) - (0.5 if rails == "dual" else 0)
    return Rails.of(light_law(light).fit(torch.from_numpy(wild), rails)).difference.numpy()


def quick(data: Dataset, design: str = "deepfsi", masks: int | None = None, **settings) -> Design:
    """Train for a moment, in float32 on the processor."""
    if masks is None:
        low, high = count_allowed(design, data)
        masks = min(max(low, 7), high)
    if design == "custom":
        light, rails = settings.get("light", "column"), settings.get("rails", "dual")
        settings["matrix"] = own_matrix(masks, data.pixels, light, rails)
    given = {**RECIPE, "photons": PHOTONS, "device": "cpu"}
    return learn(data, design=design, masks=masks, **{**given, **settings})


once = cache(quick)
"""`quick` that gives the same design each time: do not change it."""


def two_valued(rails: Tensor) -> bool:
    """True if every entry (..., N) is 0 or its frame's peak, exactly."""
    return bool(((rails == 0) | (rails == rails.amax(dim=-1, keepdim=True))).all())


def parameters(design: Design) -> list[torch.Tensor]:
    exposure = design.exposure
    return [design.rails.stacked, exposure.mean, exposure.std, *design.classifier.parameters()]


def same(first: Design, second: Design) -> bool:
    return all(map(torch.equal, parameters(first), parameters(second)))


@cache
def _digits() -> Dataset:
    return load_dataset("digits")


def _made(design: str, light: str, rails: str) -> Design:
    return once(_digits(), design, light=light, rails=rails)


@pytest.fixture
def call(monkeypatch, capsys) -> Callable[..., tuple[object, str, str]]:
    """Run a command line; gives its exit code, what it printed, and its errors."""
    from deepfsi import cli

    monkeypatch.setattr("deepfsi.base.progress.FIRST_LINE_SECONDS", 1e6)  # at no load such lines

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["deepfsi", *map(str, words)])
        with pytest.raises(SystemExit) as stop:
            cli.run_command_line()
        printed = capsys.readouterr()
        return stop.value.code, printed.out, printed.err

    return run


@pytest.fixture
def done(call) -> Callable[..., str]:
    """Run a command line that ends well; gives what it printed."""

    def run(*words):
        code, out, errors = call(*words)
        assert code == 0, errors
        return out

    return run


@pytest.fixture
def refuse(call, tmp_path) -> Callable[..., str]:
    """Run a command line that is refused in one line and writes nothing; gives the line."""

    def run(*words):
        before = sorted(tmp_path.rglob("*"))
        code, out, errors = call(*words)
        assert (code, out) == (2, ""), errors
        assert errors.startswith("deepfsi: ")
        assert errors.count("\n") == 1, errors
        assert "Traceback" not in errors
        assert sorted(tmp_path.rglob("*")) == before
        return errors

    return run


@pytest.fixture(scope="session")
def digits() -> Dataset:
    return _digits()


@pytest.fixture(scope="session")
def made() -> Callable[[str, str, str], Design]:
    """Give a design trained on digits for a moment; the same one each time: do not change it."""
    return _made


@pytest.fixture(scope="session")
def good(digits: Dataset) -> Design:
    """Give a design that classifies digits well."""
    return quick(digits, masks=10, epochs=15, hidden=(40, 128))


def light_on(design: Design, x: np.ndarray, photons: float = PHOTONS) -> Tensor:
    """λ of scenes, float64."""
    return torch.from_numpy(x).double() * (photons / design.summed_reflectance)


def assert_moments(
    samples: Tensor,
    mean: Tensor | float,
    variance: Tensor | float,
    *,
    poisson: bool,
    rounding: Tensor | float = 0.0,
) -> None:
    """Mean and variance of independent samples (n, ...), Gaussian or Poisson, to five sigma.

    `rounding` is the largest rounding error of one sample.
    """
    n, samples = len(samples), samples.double().movedim(0, -1).contiguous()
    fourth = 3 * variance**2 + (variance if poisson else 0)
    mean_error = 5 * (variance / n) ** 0.5 + rounding
    variance_error = 5 * ((fourth - variance**2) / n) ** 0.5 + rounding**2
    assert ((samples.mean(dim=-1) - mean).abs() <= mean_error).all()
    assert ((samples.var(dim=-1) - variance).abs() <= variance_error).all()


@pytest.fixture
def uncharacterised(monkeypatch):
    """Train masks and networks alone, and not `made`, which other tests share.

    What is found of a design afterwards, its readouts and its confidence, takes longer than a
    training of a moment.
    """
    from deepfsi.training import learning  # by its path it is not found after it was left out

    monkeypatch.setattr(learning, "characterise", lambda *_: None)


def _trained_once():
    """Train designs of few scenes once: not ten times more, with a part of them left out."""
    from deepfsi.training import learning  # by its path it is not found after it was left out

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learning, "folds_of", lambda data: [])
        yield


trained_once = pytest.fixture(_trained_once)
all_trained_once = pytest.fixture(_trained_once, scope="module")
"""Also in fixtures of the module."""


@pytest.fixture
def undrawn(monkeypatch):
    """Leave figures empty when they are saved, which takes most of the time of a page."""
    from matplotlib.figure import Figure

    def blank(figure, file, **_):
        file.write(b"")

    monkeypatch.setattr(Figure, "savefig", blank)


def _drawn_once():
    """Draw figures for their page alone, and leave the other files beside it empty."""
    from matplotlib.figure import Figure

    usual = Figure.savefig

    def save(figure, file, **options):
        if options["format"] == "svg":
            usual(figure, file, **options)
        else:
            file.write(b"")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", save)
        yield


drawn_once = pytest.fixture(_drawn_once)
all_drawn_once = pytest.fixture(_drawn_once, scope="module")
"""Also in fixtures of the module."""


@pytest.fixture
def images(tmp_path):
    """A folder with two classes of ten 6x8 grey images: dark cats, bright dogs."""
    rng = np.random.default_rng(2)
    save_images(tmp_path / "pets" / "cat", rng.integers(0, 100, (10, 6, 8), dtype=np.uint8))
    save_images(tmp_path / "pets" / "dog", rng.integers(150, 256, (10, 6, 8), dtype=np.uint8))
    return tmp_path / "pets"


@pytest.fixture
def split(images, tmp_path):
    """A folder with its own split: 10 cats and 10 dogs to train on, one and three to test."""
    split = tmp_path / "split"
    split.mkdir()
    images.rename(split / "train")
    save_images(split / "test" / "dog", np.full((3, 6, 8), 200, np.uint8))
    save_images(split / "test" / "cat", np.full((1, 6, 8), 20, np.uint8))
    return split


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """Give a headless Chromium with a profile of its own."""
    from shared.browser import chromium  # needs selenium, which few tests do

    with chromium(tmp_path_factory.mktemp("profile")) as chrome:
        chrome.set_script_timeout(60)
        yield chrome


@pytest.fixture
def opened(browser, pages):
    """Open the page of a kind of design, at the address that `pages` gives, and wait for it."""
    from shared.playground import open_playground

    return lambda kind, *screen, **motion: open_playground(browser, pages(kind), *screen, **motion)


@pytest.fixture(scope="session")
def deepinv():
    """Import deepinv; the torchvision of package indexes does not know torch's CPU build."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import deepinv
        except RuntimeError:
            library = torch.library.Library("torchvision", "DEF")
            for operator in ("nms", "qnms"):
                library.define(f"{operator}(Tensor boxes) -> Tensor")
            import deepinv
    return deepinv
