"""What a user of Python is shown: names of settings, answers to mistakes, types of the examples."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import deepfsi
from deepfsi.sweeps.plan import check_settings
from deepfsi.sweeps.recipe import Recipe

ROOT = Path(__file__).parents[1]

PYDANTICS = re.compile(
    "validation error|should be|not permitted|field required|parse|pydantic", re.I
)
"""Words of pydantic, which no message has."""


def learn(**settings):
    return deepfsi.learn("digits", **{"masks": 4, "photons": 1e4, **settings})


def evaluate(**settings):
    return deepfsi.evaluate(design(), "digits", **{"photons": 1e4, "draws": 1, **settings})


def recipe(**settings):
    return check_settings(settings, lambda _: deepfsi.load_dataset("digits"))


def device_file(text):
    Path("device.toml").write_text(text)
    return deepfsi.Camera(device="device.toml")


def design():
    """A design of four masks that were never trained."""
    from torch import nn, rand

    scanner = deepfsi.Scanner.from_rails(rand(1, 4, 64) / 100)
    return deepfsi.design_of(scanner, nn.Linear(4, 10), "digits", 1e4)


MISTAKES = [
    # names
    (evaluate, {"nosie": "none"}, "no such setting: did you mean 'noise'?"),
    (learn, {"camera": {"nosie": "none"}}, "no such setting: did you mean 'noise'?"),
    (Recipe, {"design": ["pca"]}, "design = .*: .*did you mean 'designs'?"),
    (device_file, {"text": "colums = 3"}, "at colums: there is no such setting: did you mean 'col"),
    # types
    (learn, {"masks": "ten"}, "masks = 'ten': give a whole number"),
    (learn, {"design": 3}, "unknown design '3': give one of"),
    (evaluate, {"photons": [1e3, None]}, "photon budget None is not allowed"),
    (deepfsi.Camera, {"device": {"columns": 3}}, "device.name: it is missing: give one"),
    (deepfsi.Training, {"classifier": None}, "classifier = None: give mlp, or"),
    (learn, {"photons": True}, "budget True is not allowed.* such as 1e4"),
    (learn, {"photons": (1e3, 1e4)}, "is not allowed: give a number"),
    (deepfsi.load_dataset, {"source": object()}, "given as object: give a Dataset"),
    # nesting
    (learn, {"exposure": {"exposure": {"span": 4}}}, "an exposure has no setting 'exposure'"),
    (learn, {"training": {"training": {}}}, "training: there is no such setting: give one of"),
]


@pytest.mark.usefixtures("uncharacterised")
@pytest.mark.parametrize(("call", "given", "words"), MISTAKES)
def test_a_mistake_is_answered_in_one_plain_line(call, given, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(deepfsi.InputError, match=words) as error:
        call(**given)
    assert "\n" not in str(error.value)
    assert not PYDANTICS.search(str(error.value))


def test_numbers_of_numpy_are_numbers():
    job = deepfsi.Job(
        masks=np.int32(4), photons=np.float32(1e4), exposure={"span": np.int64(2)}, camera="dmd"
    )
    assert job == deepfsi.Job(masks=4, photons=1e4, exposure=deepfsi.Range(span=2))


def test_what_is_none_is_not_given():
    nothing = dict.fromkeys(("design", "camera", "exposure", "training", "seed"))
    assert deepfsi.Job(masks=4, photons=1e4, **nothing) == deepfsi.Job(masks=4, photons=1e4)


PAGES = {
    page.relative_to(ROOT).with_suffix("").as_posix(): blocks
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("[!_g]*/**/*.md"))]
    if (blocks := re.findall(r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE))
}
"""Blocks of Python of README and of the pages that people write."""

DATA = 'import deepfsi\ndata = deepfsi.load_dataset("digits")'
ANYTHING = "from typing import Any, cast\n{0} = cast(Any, ...)"
BEFORE = {
    "docs/do/live": ANYTHING.format("my_projector = my_counter = my_display"),
    "docs/develop/drivers": """from pathlib import Path
from deepfsi.counting.acquisition import Acquisition, Scene
"""
    + ANYTHING.format("my_display = my_recording = looks")
    + '\npatterns = Path("adaptive")'
    + "\nscenes: list[Scene] = []\nacquisition = cast(Acquisition, ...)",
}
"""Names that a page leaves to its reader."""

MODULES = {"docs/do/own-loop": "mynets"}
"""Pages whose first block is a module of the reader's, and its name."""

MYPY = """[mypy]
ignore_missing_imports = true
[mypy-hypothesis.*,matplotlib.*,PIL.*,polars.*,pyparsing.*,rich.*,scipy.*,torch.*]
follow_imports = skip
follow_imports_for_stubs = true
[mypy-torch,torch._C.*,torch._tensor,torch.autograd.*,torch.functional,torch.nn.*,torch.optim.*]
follow_imports = normal
[mypy-torch.types,torch.utils,torch.utils.data.*]
follow_imports = normal
"""
"""Defaults, but for libraries that no page uses: to read them takes three quarters of the time."""


@pytest.fixture(scope="module")
def examples(tmp_path_factory):
    """Folder of the pages' Python, a module for each page."""
    folder = tmp_path_factory.mktemp("examples")
    for page, (first, *rest) in PAGES.items():
        if page in MODULES:
            (folder / f"{MODULES[page]}.py").write_text(first)
        blocks = rest if page in MODULES else [first, *rest]
        text = "\n\n".join([BEFORE.get(page, ""), *blocks])
        (folder / f"{re.sub(r'[^a-z_]', '_', page)}.py").write_text(text)
    (folder / "mypy.ini").write_text(MYPY)
    (folder / "pyrightconfig.json").write_text('{"reportMissingImports": false}')
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        (sys.executable, "-m", "mypy", "--config-file=mypy.ini", "--cache-dir=/dev/null", "."),
        pytest.param(
            ("pyright", "--pythonpath", sys.executable, "."),
            marks=pytest.mark.skipif(not shutil.which("pyright"), reason="needs pyright and node"),
        ),
    ],
    ids=["mypy", "pyright"],
)
def test_examples_pass_a_checker_by_its_defaults(examples, command):
    """mypy without the plugin of pydantic; optional packages may be missing."""
    checked = subprocess.run(command, cwd=examples, capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout + checked.stderr
