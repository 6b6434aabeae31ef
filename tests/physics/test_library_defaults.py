"""What a caller's program set in torch breaks nothing it calls, and changes no number."""

from contextlib import contextmanager

import numpy as np
import pytest
import torch

import deepfsi
from deepfsi import InputError
from deepfsi.design.file import file_of
from deepfsi.design.onnx import to_onnx
from deepfsi.evaluation.page_data import playable
from deepfsi.physics.surroundings import torch_device


@contextmanager
def other_defaults():
    torch.set_default_dtype(torch.float64)
    torch.set_float32_matmul_precision("medium")
    bfloat16 = torch.autocast("cpu", dtype=torch.bfloat16)
    try:
        with torch.inference_mode(), torch.device("meta"), bfloat16:
            yield
            assert torch.get_float32_matmul_precision() == "medium"
            assert torch.get_default_dtype() == torch.float64
            assert torch.get_default_device().type == "meta"
    finally:
        torch.set_default_dtype(torch.float32)
        torch.set_float32_matmul_precision("highest")


def test_what_users_call_gives_the_same_whatever_torch_is_set_to(digits):
    """Designs of known masks, of a range and adaptive ones; all settings in force at once."""
    few = {"epochs": 1, "hidden": (8,)}

    def learn(**settings):
        made = deepfsi.learn(digits, photons=1e4, masks=3, camera="dmd", **settings)
        return made, [each.as_dict() for each in deepfsi.evaluate(made, digits, 1e4, draws=1)]

    settings = ({"training": few}, {"training": few, "exposure": deepfsi.Range(span=10)},
                {"design": "adaptive"})  # fmt: skip
    (design, _), *_ = designs = [learn(**each) for each in settings]
    counts = np.random.default_rng(0).poisson(100, (60, *design.counts_shape))
    calls = [
        lambda: str(deepfsi.ideal_observer(design, digits, 1e4, draws=1)),
        lambda: design.classify(counts, 1e4).tolist(),
        lambda: to_onnx(design),
        lambda: str(playable(design, digits)),
    ]
    wanted = [call() for call in calls]
    with other_defaults():
        again = [learn(**each) for each in settings]
        assert [call() for call in calls] == wanted
    for (before, tests), (now, same) in zip(designs, again, strict=True):
        now.info["seconds"] = before.info["seconds"]
        assert file_of(now).to_bytes() == file_of(before).to_bytes()
        assert same == tests


def test_a_device_is_one_that_torch_has(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert torch_device("auto") == torch.device("cuda")
    assert torch_device("cuda:1") == torch_device(torch.device("cuda", 1)) == torch.device("cuda:1")
    with pytest.raises(InputError, match="2 CUDA devices here, and no cuda:2"):
        torch_device("cuda:2")
    with pytest.raises(InputError, match=r"^unknown device 'cuda:x': choose auto, cpu, cuda"):
        torch_device("cuda:x")
