"""Devices that torch computes on, by their names."""

import pytest
import torch

from deepfsi import InputError
from deepfsi.physics.surroundings import torch_device


def test_a_device_is_one_that_torch_has(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert torch_device("auto") == torch.device("cuda")
    assert torch_device("cuda:1") == torch_device(torch.device("cuda", 1)) == torch.device("cuda:1")
    with pytest.raises(InputError, match="torch sees 2 of CUDA"):
        torch_device("cuda:2")
    with pytest.raises(InputError, match=r"^unknown device 'cuda:x': choose auto, cpu, cuda"):
        torch_device("cuda:x")
