"""The page that gives a run's counts to other packages: its readouts are A x, to their noise."""

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.optimize import nnls

from deepfsi.camera.device import Device
from deepfsi.counting.recording import Recording
from deepfsi.lab.virtual_optics import VirtualCamera
from deepfsi.patterns.folder import Patterns
from deepfsi.patterns.rails import DesignRails
from deepfsi.physics.laws import light_law
from shared.virtual_runs import record

PAGE = (Path(__file__).parents[1] / "docs/do/pictures.md").read_text()
RUN, DESIGN, REAL = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
DATA = Path(os.environ.get("DEEPFSI_DATA") or ".")
SHAPE = (2, 4)
SCENES = np.random.default_rng(4).uniform(0.1, 1, (3, *SHAPE))


@pytest.mark.parametrize(
    ("light", "rails"), [("equal-dwell", "dual"), ("free-dwell", "single"), ("two-arm", "dual")]
)
def test_readouts_are_the_matrix_times_the_scene(tmp_path, light, rails):
    wild = np.random.default_rng(3).random((20, 8)) - (0.5 if rails == "dual" else 0)
    fitted = light_law(light).fit(torch.from_numpy(wild), rails).numpy()
    Patterns.from_rails(
        DesignRails(fitted, light, SHAPE, 5.0),
        Device(name="small", columns=40, rows=20, shortest_us=10),
        1e-3,
    ).write(tmp_path / "patterns")
    camera = VirtualCamera(dark=1e6)
    told = {"repeats": 2, "seed": 0}
    run = record(tmp_path / "run", tmp_path / "patterns", SCENES, camera, 5e7, 5e-3, **told)
    Recording.read(run).count()
    names: dict[str, Any] = {}
    exec(RUN, names)
    y, variance, matrix = names["linear_model"](run)
    scenes, read = SCENES.reshape(3, 8), variance.min(axis=0) > 0
    off = ((y - scenes @ matrix.T)[:, read] / variance[:, read] ** 0.5).ravel()
    assert abs(off.mean()) < 5 / len(off) ** 0.5
    assert abs((off**2).mean() - 1) < 5 * (2 / len(off)) ** 0.5
    weights = variance[0, read] ** -0.5
    weighted = matrix[read] * weights[:, None]
    error = np.linalg.inv(weighted.T @ weighted).diagonal() ** 0.5
    found = nnls(weighted, y[0, read] * weights)[0]
    assert (abs(found - scenes[0]) / error).max() < 4.5


@pytest.mark.usefixtures("deepinv")
def test_a_design_is_an_operator_and_real_counts_are_pictures(capsys, monkeypatch):
    names: dict[str, Any] = {}
    exec(DESIGN, names)
    assert names["pictures"].shape == names["images"].shape
    if not (DATA / "spc_photon_counter").exists():
        pytest.skip("needs $DEEPFSI_DATA/spc_photon_counter")
    monkeypatch.chdir(DATA)
    exec(REAL, {})
    printed = [list(map(float, line.split())) for line in capsys.readouterr().out.splitlines()]
    said = [list(map(float, line.split())) for line in re.findall(r"^    ([\d. ]+)$", PAGE, re.M)]
    np.testing.assert_allclose(printed, said, atol=0.02)  # kernels of other processors learn alike
