"""What a caller's program set in torch and NumPy breaks nothing it calls, and changes no number."""

from contextlib import ExitStack, contextmanager

import numpy as np
import pytest
import torch

import deepfsi
from deepfsi import InputError
from deepfsi.design.onnx import to_onnx
from deepfsi.evaluation.page_data import playable
from deepfsi.physics.surroundings import torch_device
from shared.pictures import save_images


@contextmanager
def changed(change, value, back):
    change(value)
    try:
        yield
    finally:
        change(back)


SETTINGS = (
    torch.no_grad,
    torch.inference_mode,
    lambda: changed(torch.set_grad_enabled, False, True),
    lambda: changed(torch.set_default_dtype, torch.float64, torch.float32),
    lambda: changed(torch.set_default_device, "meta", None),
    lambda: torch.device("meta"),
    lambda: torch.autocast("cpu", dtype=torch.bfloat16),
    lambda: changed(torch.set_float32_matmul_precision, "medium", "highest"),
    lambda: torch.autograd.set_detect_anomaly(True),
    lambda: changed(torch.use_deterministic_algorithms, True, False),
    lambda: np.errstate(all="raise"),
    lambda: changed(torch.manual_seed, 5, 0),
)


def state():
    return (
        torch.is_grad_enabled(),
        torch.is_inference_mode_enabled(),
        torch.get_default_dtype(),
        torch.get_default_device(),
        torch.is_autocast_enabled("cpu"),
        torch.get_float32_matmul_precision(),
        torch.is_anomaly_enabled(),
        torch.are_deterministic_algorithms_enabled(),
        torch.get_num_threads(),
        torch.get_rng_state().numpy().tobytes(),
        np.geterr(),
    )


def under_all(call):
    """What a call gives where all these settings are in force, which it leaves as they were."""
    with ExitStack() as stack:
        for setting in SETTINGS:
            stack.enter_context(setting())
        before = state()
        found = call()
        assert state() == before
    return found


def same(wanted, found):
    if isinstance(wanted, torch.Tensor):
        assert not found.is_inference()
        assert not found.requires_grad
        assert found.dtype == wanted.dtype
        return torch.equal(wanted, found)
    return np.array_equal(wanted, found) if isinstance(wanted, np.ndarray) else wanted == found


def test_everything_that_users_call_gives_the_same_whatever_torch_is_set_to(digits, tmp_path):
    """Designs of known masks, of a range and adaptive ones; all settings in force at once."""
    span = deepfsi.Range(span=10)
    training = {"epochs": 1, "hidden": (8,)}

    def learn(exposure=None):
        given = {"exposure": exposure} if exposure else {}
        return deepfsi.learn(digits, photons=1e4, masks=3, training=training, **given)

    def learn_adaptive():
        return deepfsi.learn(digits, design="adaptive", masks=3, photons=1e4, camera="dmd")

    design, ranged, adaptive = learn(), learn(span), learn_adaptive()
    file = design.save(tmp_path / "d.safetensors")
    adaptive_file = adaptive.save(tmp_path / "a.safetensors")
    rng = np.random.default_rng(0)
    save_images(tmp_path / "new", rng.integers(0, 255, (1, 8, 8), dtype=np.uint8))
    counts = rng.poisson(100, (60, *design.counts_shape))

    def results():
        every = (
            deepfsi.evaluate(each, digits, 1e4, draws=1) for each in (design, ranged, adaptive)
        )
        return [result.as_dict() for one in every for result in one]

    calls = [
        lambda: learn_adaptive().prior_exposure.prior.components,
        lambda: learn(span).exposure.mean,
        lambda: deepfsi.load_design(file).rails.stacked,
        lambda: deepfsi.load_design(adaptive_file).prior_exposure.prior.components,
        lambda: [design.to_bytes(), adaptive.to_bytes()],
        lambda: str(deepfsi.ideal_observer(design, digits, 1e4, draws=1)),
        lambda: design.classify(counts, 1e4),
        lambda: design.consistency(counts, 1e4).exposures,
        lambda: deepfsi.predict(design, tmp_path / "new", 1e4).as_csv(),
        lambda: to_onnx(design),
        lambda: str(playable(ranged, digits)),
        lambda: adaptive.looks_at(digits.x_test[0].ravel(), 1e4)[0],
        results,
    ]
    for number, call in enumerate(calls):
        with torch.no_grad():
            wanted = call()
        assert same(wanted, under_all(call)), number


def test_a_device_is_one_that_torch_has(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert torch_device("auto") == torch.device("cuda")
    assert torch_device("cuda:1") == torch_device(torch.device("cuda", 1)) == torch.device("cuda:1")
    with pytest.raises(InputError, match="2 CUDA devices here, and no cuda:2"):
        torch_device("cuda:2")
    with pytest.raises(InputError, match=r"^unknown device 'cuda:x': choose auto, cpu, cuda"):
        torch_device("cuda:x")
