"""Devices that torch computes on, by their names."""

import pytest
import torch

from deepfsi import InputError, learn
from deepfsi.physics import torch_device

NO_GPU = pytest.mark.skipif(torch.cuda.is_available(), reason="has a GPU")
NO_MPS = pytest.mark.skipif(torch.backends.mps.is_available(), reason="has a GPU of Apple")


@pytest.mark.parametrize("given", ["cpu", "cpu:0", torch.device("cpu"), torch.device("cpu", 0)])
def test_the_processor_has_one_name(given):
    assert torch_device(given) == torch.device("cpu")


@pytest.mark.parametrize("given", ["gpu", "cuda:x", "cuda:-1", "meta", "xpu", "", 0, None])
def test_an_unknown_device_is_refused(given):
    with pytest.raises(InputError, match=r"^unknown device '.*': choose auto, cpu, cuda, cuda:1"):
        torch_device(given)


@pytest.mark.parametrize(
    "given",
    [
        pytest.param("cuda", marks=NO_GPU),
        pytest.param("cuda:1", marks=NO_GPU),
        pytest.param(torch.device("cuda"), marks=NO_GPU),
        pytest.param("mps", marks=NO_MPS),
        "cuda:99",
        "cpu:1",
    ],
)
def test_a_missing_device_is_said(given):
    with pytest.raises(InputError, match=rf"^device {given} is not here.*: use `device=\"cpu\"`"):
        torch_device(given)


def test_the_count_of_gpus_bounds_their_numbers(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert torch_device("auto") == torch.device("cuda")
    assert torch_device("cuda:1") == torch_device(torch.device("cuda", 1)) == torch.device("cuda:1")
    with pytest.raises(InputError, match="torch sees 2 of CUDA"):
        torch_device("cuda:2")


def test_a_design_is_trained_and_moved_by_a_device_of_torch(digits):
    design = learn(
        digits,
        design="raster",
        masks=64,
        photons=1e5,
        training={"epochs": 1},
        device=torch.device("cpu", 0),
    )
    assert design.info["device"] == "cpu"
    assert design.to("auto").rails.device.type in ("cpu", "cuda")
    with pytest.raises(InputError, match="unknown device 'gpu'"):
        design.to("gpu")
