"""The page that gives a run's counts to deepinv and SpyRIT.

Its code is held to its formulas with stand-ins of what it takes from both packages, and runs as it
is where they can be imported.
"""

import importlib
import re
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from conftest import generator
from deepfsi.camera.device import Device
from deepfsi.hardware.counting.acquisition import read_run
from deepfsi.hardware.counting.count import count_run
from deepfsi.hardware.counting.counts import read_counts
from deepfsi.hardware.patterns.folder import FrameSettings, export_patterns
from deepfsi.hardware.patterns.manifest import DesignRails
from deepfsi.hardware.virtual.camera import RecordingSettings, VirtualCamera, record_scenes
from deepfsi.physics.laws import light_law

PAGE = (Path(__file__).parents[1] / "docs/notebook/pictures.md").read_text()
READ, DEEPINV, SPYRIT, SHOW = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
[SHELL] = re.findall(r"```\n(deepfsi .*?)```", PAGE, flags=re.DOTALL)
LINES = SHELL.replace("\\\n", "").splitlines()

FLUX, EXPOSURE, DARK, SUMMED, SHAPE = 5e7, 5e-3, 1e6, 5.0, (2, 4)
SCENES = np.random.default_rng(4).uniform(0.1, 1, (3, *SHAPE))
OPTICS = ("equal-dwell", "dual"), ("free-dwell", "single"), ("two-arm", "dual")


class Linearity(nn.Module):
    """What the page needs of deepinv's `LinearPhysics`."""

    def __init__(self, img_size: tuple[int, ...]) -> None:
        super().__init__()
        self.img_size = img_size

    def A_dagger(self, y: Tensor) -> Tensor:
        pixels = torch.eye(int(np.prod(self.img_size)), dtype=y.dtype)
        rows = self.A(pixels.unflatten(1, self.img_size))  # (N, k)
        return (y @ torch.linalg.pinv(rows)).unflatten(1, self.img_size)


def climb(max_iter: int):
    """deepinv's `MLEM` by its formula, from a picture of ones."""

    def run(y: Tensor, camera: nn.Module) -> Tensor:
        x = torch.ones_like(camera.A_adjoint(y))
        for _ in range(max_iter):
            mean = camera.A(x, add_background=True).clamp(min=1e-6)
            seen = camera.A_adjoint(torch.ones_like(y)).clamp(min=1e-6)
            x = x * camera.A_adjoint(y / mean) / seen
        return x

    return run


class Matrix(nn.Module):
    """What the page needs of SpyRIT's `Linear`."""

    def __init__(self, H: Tensor, meas_shape: tuple[int, ...], dtype: torch.dtype) -> None:
        super().__init__()
        self.H, self.shape = H.to(dtype), meas_shape

    def measure(self, x: Tensor) -> Tensor:
        return x.flatten(-2) @ self.H.T


def invert(camera: Matrix, store_H_pinv: bool, rcond: float):
    """SpyRIT's `PseudoInverse` by its formula."""
    back = torch.linalg.pinv(camera.H, rcond=rcond)
    return lambda y: (y @ back.T).unflatten(-1, camera.shape)


def estimate(camera: Matrix, sigma: Tensor):
    """SpyRIT's `Tikhonov` by its formula."""

    def run(y: Tensor, gamma: Tensor) -> Tensor:
        rest = torch.linalg.solve(camera.H @ sigma @ camera.H.T + gamma, y.unsqueeze(-1))
        return (sigma @ camera.H.T @ rest).squeeze(-1).unflatten(-1, camera.shape)

    return run


STAND_INS = {
    "deepinv": {"optim": {"MLEM": climb}, "physics": {"LinearPhysics": Linearity}},
    "spyrit": {
        "core": {},
        "core.inverse": {"PseudoInverse": invert, "Tikhonov": estimate},
        "core.meas": {"Linear": Matrix},
    },
}


def names_of(*blocks: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    for block in blocks:
        exec(block, names)
    return names


def code(block: str, package: str, monkeypatch) -> SimpleNamespace:
    """Names that the page's first block and another make on stand-ins."""
    monkeypatch.setitem(sys.modules, package, ModuleType(package))
    for name, held in STAND_INS[package].items():
        module = ModuleType(f"{package}.{name}")
        vars(module).update(held)
        monkeypatch.setitem(sys.modules, module.__name__, module)
    return SimpleNamespace(**names_of(READ, block))


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Give folders of counted runs, with dark counts and several exposures, by their optics."""
    made = {}
    for light, rails in OPTICS:
        folder = tmp_path_factory.mktemp(light)
        wild = np.random.default_rng(3).random((20, 8)) - (0.5 if rails == "dual" else 0)
        fitted = light_law(light).fit(torch.from_numpy(wild), rails).numpy()
        export_patterns(
            DesignRails(fitted, light, SHAPE, SUMMED),
            FrameSettings(Device(name="small", columns=40, rows=20, shortest_us=10), 1e-3),
            folder / "patterns",
        )
        settings = RecordingSettings(VirtualCamera(dark=DARK), FLUX, EXPOSURE, repeats=2)
        names = ("a", "b", "c")
        record_scenes(folder / "patterns", SCENES, names, None, folder / "run", settings)
        count_run(folder / "run")
        made[light] = folder / "run"
    return made


every_optics = pytest.mark.parametrize("light", [light for light, _ in OPTICS])


@every_optics
def test_counts_are_poisson_with_the_mean_of_the_matrix(runs, light):
    run = names_of(READ)["read"](runs[light])
    scenes = torch.from_numpy(SCENES.reshape(3, 8))
    photons = scenes / run.reflectance[:, None]
    assert np.allclose(run.reflectance, SUMMED / (2 * FLUX * EXPOSURE))
    light_of = torch.einsum("rmn,sn->srm", run.rails, photons)
    mean = light_of + run.background
    read = mean > 0
    off = ((run.counts - mean) / mean.sqrt())[read]
    assert abs(off.mean()) < 5 / len(off) ** 0.5
    assert abs(off.square().mean() - 1) < 5 * (2 / len(off)) ** 0.5
    # Dark counts of 10⁶ a second in 2 exposures of 5 ms, to the noise of the all-OFF frames
    dark = run.background.sum(dim=(1, 2)) / (len(run.rails) if light == "two-arm" else 1)
    assert np.allclose(dark, 2 * DARK * EXPOSURE, rtol=0.1)
    torch.testing.assert_close(run.variance, run.counts)


def test_without_a_flux_the_scenes_are_taken_as_bright_as_the_training(runs):
    """To 1 %, several times the noise of their all-ON frames."""
    names = names_of(READ)
    recorded = read_run(runs["equal-dwell"])
    unknown = recorded.acquisition.model_copy(update={"flux": None})
    names["read_run"] = lambda folder: replace(recorded, acquisition=unknown)
    run = names["read"](runs["equal-dwell"])
    brightness = SCENES.sum(axis=(1, 2)).mean() / SUMMED
    photons = 2 * FLUX * EXPOSURE * brightness
    assert np.allclose(run.reflectance, SUMMED / photons, rtol=0.01)


def test_an_exposure_that_was_lost_is_left_out(runs):
    names = names_of(READ)
    whole, counts = names["read"](runs["two-arm"]), read_counts(runs["two-arm"])
    valid = counts.valid.copy()
    valid[0], valid[1, 1] = False, False
    kept = counts.by_readout(valid)
    lost = {"valid": valid, "counts": counts.counts * kept, "arrivals": counts.arrivals * kept}
    ambient = np.full_like(counts.ambient_variance, 7.0)
    names["read_counts"] = lambda run: replace(
        counts, variance=counts.variance * kept, ambient_variance=ambient, **lost
    )
    run = names["read"](runs["two-arm"])
    assert run.sound.tolist() == [False, True, True]
    torch.testing.assert_close(
        run.background, whole.background[1:] / torch.tensor([[[2.0]], [[1]]])
    )
    torch.testing.assert_close(
        run.reflectance, whole.reflectance[1:] * torch.tensor([2.0, 1]).double()
    )
    once = torch.from_numpy(counts.arrivals[1, 0])
    torch.testing.assert_close(run.counts, torch.stack([once, whole.counts[2]]))
    added = (run.variance - run.counts).flatten(1).double()
    torch.testing.assert_close(added, torch.tensor([[7.0], [28]]).double().expand_as(added))


@every_optics
def test_deepinv(runs, light, monkeypatch):
    page = code(DEEPINV, "deepinv", monkeypatch)
    run = page.read(runs[light])
    camera, counts = page.SinglePixelCamera(run), run.counts.flatten(1)
    u = torch.randn(3, 1, *SHAPE, generator=generator(), dtype=torch.float64)
    v = torch.randn(counts.shape, generator=generator(1), dtype=torch.float64)
    there, back = (camera.A(u) * v).sum(dim=1), (u * camera.A_adjoint(v)).sum(dim=(1, 2, 3))
    torch.testing.assert_close(there, back)
    seen = camera.A(u, add_background=True) - camera.A(u)
    torch.testing.assert_close(seen, run.background.flatten(1))

    plain, likely = page.by_deepinv(run, 300)
    scenes = torch.from_numpy(SCENES)
    inverse = torch.linalg.pinv(camera.masks) * run.reflectance[0]
    error = (inverse**2 @ run.variance.flatten(1).T).T.sqrt().reshape(scenes.shape)
    assert ((plain - scenes) / error).abs().max() < 4.5  # 24 pixels
    assert likely.min() >= 0

    def likelihood(pictures: Tensor) -> Tensor:
        photons = (pictures / run.reflectance[:, None, None])[:, None]
        mean = camera.A(photons, add_background=True)
        return (torch.xlogy(counts, mean) - mean).sum(dim=1)

    assert (likelihood(likely) > likelihood(scenes)).all()


@every_optics
def test_spyrit(runs, light, monkeypatch):
    """The estimate is that of least mean squared error, in its other form."""
    page = code(SPYRIT, "spyrit", monkeypatch)
    run = page.read(runs[light])
    pictures = torch.rand(200, 8, generator=generator(), dtype=torch.float64)
    plain, likely = page.by_spyrit(run, pictures)
    unit = float(run.reflectance[0])
    if len(run.rails) == 2:
        masks, counts = run.rails[0] - run.rails[1], run.counts[:, 0] - run.counts[:, 1]
        counts = counts - run.background[:, 0] + run.background[:, 1]
    else:
        masks, counts = run.rails[0], run.counts[:, 0] - run.background[:, 0]
    found, scenes = run.variance.sum(dim=1), torch.from_numpy(SCENES)
    inverse = torch.linalg.pinv(masks) * unit
    error = (inverse**2 @ found.T).T.sqrt().reshape(scenes.shape)
    assert ((plain - scenes) / error).abs().max() < 4.5  # 24 pixels
    mean, prior = pictures.mean(dim=0), torch.linalg.inv(torch.cov(pictures.T))
    for place in range(3):
        weighted = masks.T / found[place] / unit**2
        rest = counts[place] * unit - masks @ mean
        best = mean + torch.linalg.solve(weighted @ masks + prior, weighted @ rest)
        torch.testing.assert_close(likely[place].flatten(), best)


@pytest.mark.filterwarnings("default")  # the packages' own warnings are not ours
def test_the_page(tmp_path, monkeypatch, done):
    for package in ("deepinv", "spyrit"):
        try:
            importlib.import_module(package)
        except (ImportError, RuntimeError) as error:  # where torchvision is of another torch
            pytest.skip(f"{package} cannot be imported: {error}")
    monkeypatch.chdir(tmp_path)
    for line in LINES:
        done(*shlex.split(line)[1:], *(("--epochs", "5") if "design" in line.split()[1] else ()))
    errors = names_of(READ, DEEPINV, SPYRIT, SHOW)["errors"]
    assert (tmp_path / "pictures.png").is_file()
    assert errors["learned", "Tikhonov"] < errors["learned", "Richardson-Lucy"] < 1
    assert errors["hadamard", "Tikhonov"] < errors["hadamard", "Richardson-Lucy"] < 0.6
