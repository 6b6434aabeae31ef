"""What a caller's program set in torch and NumPy breaks nothing it calls, and changes no number."""

from contextlib import ExitStack, contextmanager

import numpy as np
import pytest
import torch
from PIL import Image

import deepfsi
from deepfsi.design import to_onnx
from deepfsi.evaluation import playable, stop
from deepfsi.hardware.counting import TableSettings
from deepfsi.lab.adaptive_looks import adaptive_rails
from deepfsi.sweeps import Recipe, compare

FEW = deepfsi.Training(epochs=1, hidden=(8,))


@contextmanager
def changed(change, value, back):
    change(value)
    try:
        yield
    finally:
        change(back)


SETTINGS = {
    "no gradients": torch.no_grad,
    "inference mode": torch.inference_mode,
    "gradients switched off": lambda: changed(torch.set_grad_enabled, False, True),
    "float64": lambda: changed(torch.set_default_dtype, torch.float64, torch.float32),
    "another device": lambda: changed(torch.set_default_device, "meta", None),
    "another device, around": lambda: torch.device("meta"),
    "autocast": lambda: torch.autocast("cpu", dtype=torch.bfloat16),
    "coarse products": lambda: changed(torch.set_float32_matmul_precision, "medium", "highest"),
    "anomalies": lambda: torch.autograd.set_detect_anomaly(True),
    "deterministic": lambda: changed(torch.use_deterministic_algorithms, True, False),
    "NumPy's errors": lambda: np.errstate(all="raise"),
    "another seed": lambda: changed(torch.manual_seed, 5, 0),
}


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


def under(names, call):
    """What a call gives where all these settings are in force, which it leaves as they were."""
    with ExitStack() as stack:
        for name in names:
            stack.enter_context(SETTINGS[name]())
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


@pytest.mark.parametrize("setting", SETTINGS)
def test_a_design_is_learned_whatever_torch_is_set_to(digits, setting):
    def learn():
        return deepfsi.learn(digits, photons=1e4, masks=3, training=FEW).rails.stacked

    assert same(learn(), under([setting], learn))


def test_everything_that_users_call_gives_the_same_whatever_torch_is_set_to(digits, tmp_path):
    """Designs of known masks, of looks, and adaptive; all settings in force at once."""

    held = digits.hold_out(239)

    def learn(data=digits, **others):
        return deepfsi.learn(data, photons=1e4, masks=3, training=FEW, **others)

    def learn_adaptive():
        return deepfsi.learn(digits, design="adaptive", masks=3, photons=1e4, camera="dmd")

    design, adaptive = learn(), learn_adaptive()
    looks = learn(held, exposure=deepfsi.Looks(looks=2))
    file, adaptive_file = tmp_path / "d.safetensors", tmp_path / "a.safetensors"
    design.save(file)
    adaptive.save(adaptive_file)
    (tmp_path / "new").mkdir()
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 255, (8, 8), dtype=np.uint8)).save(tmp_path / "new" / "a.png")
    counts = rng.poisson(100, (60, *design.counts_shape))
    np.save(tmp_path / "counts.npy", counts)
    scenes, scanner = torch.from_numpy(digits.x_test[:4].reshape(4, -1)), design.scanner()
    features = torch.from_numpy(np.full((1, design.features), 50, np.float32))

    def sweep():
        recipe = Recipe(designs=("deepfsi",), photons=(1e4,), masks=(3,), training={"epochs": 1})
        folder = tmp_path / f"sweep{len([*tmp_path.iterdir()])}"
        points = compare(recipe, digits, folder, command="a")[0].points
        return [each.as_dict() | {"seconds": 0} for each in points]

    def answers(made):
        return [each.as_dict() for each in deepfsi.evaluate(made, digits, 1e4, draws=1)]

    calls = {
        "learn adaptive": lambda: learn_adaptive().prior_exposure.prior.components,
        "learn looks": lambda: learn(exposure=deepfsi.Looks(looks=2)).mean,
        "load": lambda: deepfsi.load_design(file).rails.stacked,
        "load adaptive": lambda: deepfsi.load_design(adaptive_file).prior_exposure.prior.components,
        "save": lambda: [design.to_bytes(), adaptive.to_bytes()],
        "evaluate": lambda: [answers(each) for each in (design, looks, adaptive)],
        "ideal observer": lambda: str(deepfsi.ideal_observer(design, digits, 1e4, draws=1)),
        "classify": lambda: design.classify(counts, 1e4),
        "classify live": lambda: looks.classify_live(
            lambda shares: np.full(looks.counts_shape, 50), 1e4
        ),
        "consistency": lambda: design.consistency(counts, 1e4).exposures,
        "table": lambda: str(
            deepfsi.classify_table(
                file, tmp_path / "counts.npy", TableSettings(photons=1e4), force=True
            )
        ),
        "predict": lambda: deepfsi.predict(design, tmp_path / "new", 1e4).as_csv(),
        "rates": lambda: design.rates(scanner, scenes),
        "logits": lambda: design.logits(features, 1e4),
        "as shown": lambda: (
            design.as_shown(design.rails.stacked.numpy(), design.image_shape, 1.0)
            .quantised(8)
            .rails.stacked.numpy()
        ),
        "onnx": lambda: to_onnx(design),
        "page": lambda: str(playable(looks, digits)),
        "stop": lambda: str(stop(looks, digits, 1e4)),
        "rails": lambda: adaptive_rails(adaptive_file).rails,
        "looks": lambda: adaptive.looks_at(digits.x_test[0].ravel(), 1e4)[0],
        "sweep": sweep,
    }
    for name, call in calls.items():
        with torch.no_grad():
            wanted = call()
        assert same(wanted, under(SETTINGS, call)), name
