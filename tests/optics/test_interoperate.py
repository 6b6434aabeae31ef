"""The adapter to deepinv in the docs, with deepinv where it is installed and by its formula."""

import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from torch import nn

from conftest import PHOTONS, every_design, generator, light_on, quick, synthetic
from deepfsi.design.artifact import Design
from deepfsi.optics.budget import photons_per_pixel

PAGE = (Path(__file__).parents[2] / "docs/do/interoperate.md").read_text()
ADAPTER, EXAMPLE = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)


class StandIn(nn.Module):
    """What the adapter needs of deepinv's `LinearPhysics`."""

    def __init__(self, img_size: tuple[int, ...], device: torch.device) -> None:
        super().__init__()
        self.img_size = img_size
        self.to(device)

    def forward(self, x, **kwargs):
        return self.noise(self.A(x, **kwargs), **kwargs)


@pytest.fixture
def adapter(monkeypatch):
    """Give the class of the docs, on the stand-in."""
    physics = ModuleType("deepinv.physics")
    physics.LinearPhysics = StandIn
    monkeypatch.setitem(sys.modules, "deepinv", ModuleType("deepinv"))
    monkeypatch.setitem(sys.modules, "deepinv.physics", physics)
    names: dict[str, type] = {}
    exec(ADAPTER, names)
    return names["SinglePixelCamera"]


def images_of(design: Design, x: np.ndarray) -> torch.Tensor:
    light = photons_per_pixel(torch.from_numpy(x), PHOTONS, design.summed_reflectance)
    return light.reshape(-1, 1, *design.image_shape)


def adjointness(camera: nn.Module, samples: int = 16) -> float:
    """deepinv's own measure: ‖A − Bᵀ‖ / ‖A‖ by random vectors."""
    u = torch.randn(samples, *camera.img_size, generator=generator())
    forward = camera.A(u)
    v = torch.randn(forward.shape, generator=generator(1))
    back = camera.A_adjoint(v)
    assert back.shape == u.shape
    one, other = ((a * b).flatten(1).sum(dim=1) for a, b in ((v, forward), (u, back)))
    return float((one - other).square().mean().sqrt() / one.square().mean().sqrt())


@every_design
def test_adjoint(made, adapter, light, rails, design):
    """To the rounding of float32 sums of 64 pixels and 128 readouts, of either sign."""
    assert adjointness(adapter(made(design, light, rails))) < 1e-5


@every_design
def test_it_measures_what_the_scanner_does(digits, made, adapter, light, rails, design):
    one = made(design, light, rails)
    images = images_of(one, digits.x_test[:5])
    exact = one.scanner().rates(light_on(one, digits.x_test[:5]))
    camera = adapter(one, generator(3))
    torch.testing.assert_close(camera.A(images), exact.float(), rtol=1e-5, atol=1e-4)
    counts = camera(images)
    again = one.scanner().read(camera.A(images), generator(3))
    assert torch.equal(counts, again)
    seen = counts if one.rails.count == 2 else counts[:, 0]
    assert one.classify(seen, PHOTONS).shape == (5, 10)


def test_spectra(adapter):
    data = synthetic((12,))
    camera = adapter(quick(data, masks=4))
    assert camera.img_size == (1, 12)
    assert adjointness(camera) < 1e-5


@pytest.mark.filterwarnings("default")
def test_the_page_with_deepinv():
    pytest.importorskip("deepinv", reason="needs deepinv")
    names: dict[str, object] = {}
    exec(ADAPTER, names)
    exec(EXAMPLE, names)
    assert names["error"] < 1e-5
    assert (names["classes"] == names["data"].y_test[:8]).mean() > 0.6
    images, pictures = names["images"], names["pictures"]
    grey = images.mean()
    assert (pictures - images).square().mean() < 0.5 * (grey - images).square().mean()
