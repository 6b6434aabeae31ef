"""Lines that README and how-to pages show in blocks of `sh` and `python` are run, in order."""

import os
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import stats

from deepfsi.datasets import catalog
from shared.benchmarks import benchmark
from shared.commands import OPTIONS

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)

LINES = {
    "README": 2,
    "docs/do/compare": 6,
    "docs/do/deploy": 3,
    "docs/do/cluster": 1,
    "docs/do/camera": 8,
    "docs/do/live": 5,
    "docs/do/shared-light": 3,
    "docs/do/values": 3,
    "docs/notebook/passing": 4,
    "docs/notebook/reproduce": 1,
}
"""Pages with such lines, and the number of commands in each."""

BRIEFLY = {
    "compare": "--epochs 1 --trials 1 --designs pca,deepfsi",
    "design": "--epochs 1",
    "data": "--per-class 6",
}
"""Options that make a command take a moment."""

SMALLER = {"96": "8", "16,32": "8", "32": "8", "1e3,1e4": "1e4", "4,8,16": "8"}
"""Values of options in place of those of a page, where masks adapt or a comparison takes values:
fewer looks and masks."""

RATIOS = {"0.01,0.04,0.09": "0.04,0.09"}
"""Fewer numbers of masks of a comparison."""


def lines(page: str) -> list[str]:
    """Command lines in the blocks of `sh` of a page."""
    blocks = re.findall(r"```sh\n(.*?)```", (ROOT / f"{page}.md").read_text(), flags=re.DOTALL)
    whole = re.sub(r"\\\n\s*", "", "".join(blocks))
    return re.findall(r"^(?:\.venv/bin/)?(deepfsi .+)$", whole, flags=re.MULTILINE)


@pytest.mark.parametrize("block", BLOCKS, ids=range(len(BLOCKS)))
def test_python(block, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(block.replace('"mnist"', '"digits"').replace("epochs=20", "epochs=2"), names)
    assert names["probabilities"].shape == (len(names["data"].x_test), 10)


def test_readme_is_short_and_names_the_commands_that_do_all_the_set_up():
    """For whom, on which system, how to cite, and how much processor time `make` takes."""
    make = re.sub(r"\\\n\s*", "", (ROOT / "Makefile").read_text())
    for target, minutes in (("run", 7), ("test", 15)):
        said = f"^make {target} +# {minutes} minutes of processor time"
        assert re.search(said, README, re.MULTILINE)
        assert re.search(rf"^{target}\b.*:", make, re.MULTILINE)
    for words in ("is for people who", "Linux or macOS", "Windows", "@article", "CITATION.cff"):
        assert words in README
    assert len(README.split()) <= 450
    assert README.count("![") == 1
    compare, design, page = re.search(r"^run:.*\n((?:\t.*\n)+)", make, re.M)[1].splitlines()[-3:]
    assert re.search("compare.*adaptive", compare)
    assert "--design adaptive" in design
    assert page.endswith("-o runs/dmd/page.html")


def test_readme_says_what_make_run_printed():
    """Of a run that is stored; processors round differently, learned masks by some 0.01."""
    printed = (ROOT / "docs/make-run.txt").read_text()
    row = re.compile(r"^ (\S.*?)  +(?:\S+ +){2}(\d\.\d{3})±\S+ +\S+$", re.M)
    values = dict(row.findall(printed))
    designs = ("adaptive masks", "DeepFSI", "PCA", "raster scan")
    said = re.findall(r"0\.\d{3} with", README.partition("![")[0])
    assert said == [f"{values[design]} with" for design in designs]
    assert "10⁴ photons" in README.partition("![")[0]


def test_no_line_is_left_out():
    assert {page: len(lines(page)) for page in LINES} == LINES
    words = {line.split()[1] for page in LINES for line in lines(page)}
    assert words == {
        *("compare", "design", "evaluate", "show", "page", "export", "sweep"),
        *("reproduce", "dmd", "camera", "data", "mask"),
    }
    for page in (ROOT / "docs").glob("[!_g]*/*.md"):
        name = page.relative_to(ROOT).with_suffix("").as_posix()
        assert name in LINES or "```sh\n" not in page.read_text(), name


def test_commands_and_files_that_pages_name_exist():
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("[!_g]*/*.md")]:
        text = re.sub(r"\\\n\s*", "", page.read_text())
        for line in re.findall(r"^(deepfsi .+)$|`(deepfsi [^`]+)`", text, flags=re.MULTILINE):
            words = " ".join(line).split("#")[0].split()[1:]
            path = next((p for n in (2, 1) if (p := " ".join(words[:n])) in OPTIONS), None)
            group = {each.split()[0] for each in OPTIONS} & set(words[:1])
            assert path or len(words) == len(group) or words[len(group)][0] in "-C", line
            given = {word.split("=")[0] for word in words if re.match("--?[a-z]", word)}
            assert given <= OPTIONS.get(str(path), set()) | {"--help"}, line
        for path in re.findall(r"\b(?:tests|benchmarks|docs)/[\w/]+\.(?:py|png|svg)\b", text):
            assert (ROOT / path).is_file(), path


@pytest.fixture
def run(tmp_path, monkeypatch, done, digits, trained_once):
    """Give a function that runs a page's lines in one folder and returns what each printed.

    MNIST is small there, what trains on it is told to be brief, and its study is the shortest
    experiment of it.
    """
    from deepfsi_paper import experiment, quantization, studies
    from shared.experiments import tiny

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    few = replace(digits, x_test=digits.x_test[:100], y_test=digits.y_test[:100])
    monkeypatch.setattr(catalog.IdxImages, "load", lambda self, _: replace(few, name=self.name))
    monkeypatch.setattr("deepfsi.evaluation.page_data.TESTED", 20)
    monkeypatch.setattr("deepfsi.adaptive.exposure.SHARING_SCENES", 64)
    recipes = tiny(quantization.EXPERIMENT, 1)
    monkeypatch.setitem(studies.STUDIES, "mnist", (quantization.EXPERIMENT,))
    monkeypatch.setattr(experiment.Experiment, "recipes", lambda *_: recipes)
    monkeypatch.setattr(
        "deepfsi.cli.studies._shipped_recipes", lambda: {"mnist": tmp_path / "small.toml"}
    )
    (tmp_path / "small.toml").write_text(
        'designs = ["pca"]\nphotons = [1e2, 1e4]\nmasks = 3\n[quick]\ntraining.epochs = 1\n'
    )

    def run(page: str, whole: bool = False) -> dict[str, str]:
        printed = {}
        for line in lines(page):
            words = shlex.split(line)[1:]
            brief = "" if whole or "adaptive" in words else BRIEFLY.get(words[0], "")
            if "--cap" in words:  # of designs that may end early
                brief = brief.removesuffix("--designs pca,deepfsi")
            if {"--cap", "adaptive", "placed.npz"} & set(words):
                words = [SMALLER.get(word, word) for word in words]
            small = [RATIOS.get(word, word.replace("10000", "300")) for word in words]
            printed[" ".join(words[:2])] = done(*small, *brief.split())
        return printed

    return run


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_readme(run, tmp_path):
    rng = np.random.default_rng(0)
    for name in ("oak", "yew"):
        (tmp_path / "my-pictures" / name).mkdir(parents=True)
        for number in range(12):
            picture = Image.fromarray(rng.integers(0, 256, (40, 40), dtype=np.uint8))
            picture.save(tmp_path / "my-pictures" / name / f"{number}.png")
    [camera] = re.findall(r"```toml\n(.*?)```", README, flags=re.DOTALL)
    (tmp_path / "my-lab.toml").write_text(camera)
    run("README")
    assert (tmp_path / "runs/mine/report.html").stat().st_size > 100


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn", "uncharacterised")
@pytest.mark.parametrize(
    ("page", "made"),
    [
        ("do/compare", ("masks.png", "patterns/manifest.json", "runs/target/results.json")),
        ("do/deploy", ("digits.html", "digits.onnx")),
        ("do/shared-light", ("shared.safetensors", "runs/shared")),
        ("do/cluster", ("runs/quick/results.json",)),
        ("notebook/reproduce", ("runs/paper/report.html",)),
    ],
)
def test_pages(run, tmp_path, page, made):
    printed = run(f"docs/{page}")
    for name in made:
        assert (tmp_path / name).stat().st_size > 100 or name.endswith(".png")
    assert "cost in light" not in printed.get("dmd export", "")


@pytest.mark.slow
def test_the_camera_page_is_right_about_its_scenes(run):
    """All ten digits but one or two are classified correctly at 1e5 photons."""
    printed = run("docs/do/camera", whole=True)
    right = re.search(r"right: (\d+) of 10 exposures, none recognised", printed["camera classify"])
    assert int(right.group(1)) >= 8
    assert "Generic T2" in printed["camera inspect"]


@pytest.mark.slow
def test_the_page_of_passing_scenes_finds_and_reads_them(done, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs/notebook/passing.md").read_text()
    [learned] = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    [simulated] = re.findall(r"^python benchmarks/passing.py (.*)$", text, flags=re.MULTILINE)
    exec(learned, {})
    for line in lines("docs/notebook/passing"):
        if "transits" in line:
            benchmark("passing").main(simulated.split())
        printed = done(*shlex.split(line)[1:])
    assert "20 transits in" in printed
    assert len((tmp_path / "transits.csv").read_text().splitlines()) == 21
    assert "<polygon" in (tmp_path / "pattern.svg").read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_page_of_values_runs(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text, names = (ROOT / "docs/do/values.md").read_text(), {}
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        exec(block.replace("epochs=30", "epochs=4"), names)
    assert names["result"].r2 > 0.5
    run("docs/do/values")
    assert (tmp_path / "runs/placed/report.html").stat().st_size > 100


@pytest.mark.slow
def test_the_live_page_classifies_a_run_again(run):
    printed = run("docs/do/live")
    found = [line for line in printed["camera live"].splitlines() if ".png: " in line]
    assert len(found) == 60
    unsure = [line for line in found if "confidence" not in line]
    assert len(unsure) <= stats.binom.ppf(1 - 1e-4, 60, 0.018)
    assert "a live run, as it was decided" in printed["camera classify"]
