"""Defaults of torch and NumPy, whatever the surrounding program set, and the device."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
import torch

from deepfsi.base.errors import InputError


@contextmanager
def library_defaults(grad: bool | None = None) -> Iterator[None]:
    """Context, or decorator, in which a user's torch settings change no result.

    It resets autocast, default types and devices, and error modes. It keeps threads, deterministic
    algorithms, flushing of denormals, and the global generator, from which nothing here draws.
    """
    with ExitStack() as stack:
        stack.enter_context(np.errstate(divide="warn", over="warn", under="ignore", invalid="warn"))
        recorded = torch.is_grad_enabled() if grad is None else grad
        if torch.is_inference_mode_enabled():
            stack.enter_context(torch.inference_mode(False))  # this records gradients again
        if torch.is_grad_enabled() != recorded:
            stack.enter_context(torch.set_grad_enabled(recorded))
        for device in ("cpu", "cuda", "mps"):
            if torch.is_autocast_enabled(device):
                stack.enter_context(torch.autocast(device, enabled=False))
        if torch.is_anomaly_enabled():
            stack.enter_context(torch.autograd.set_detect_anomaly(False))
        if torch.get_default_device().type != "cpu":
            stack.enter_context(torch.device("cpu"))
        if (dtype := torch.get_default_dtype()) != torch.float32:
            torch.set_default_dtype(torch.float32)
            stack.callback(torch.set_default_dtype, dtype)
        if (precision := torch.get_float32_matmul_precision()) != "highest":
            torch.set_float32_matmul_precision("highest")
            stack.callback(torch.set_float32_matmul_precision, precision)
        yield


def torch_device(given: Any) -> torch.device:
    """Device that torch computes on."""
    gpus = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if given == "auto":
        return torch.device("cuda" if gpus else "cpu")
    try:
        device = torch.device(given)
    except (RuntimeError, TypeError):
        raise InputError(
            f"unknown device {str(given)!r}: choose auto, cpu, cuda, cuda:1 or mps"
        ) from None
    if device.type == "cuda" and (device.index or 0) < gpus:
        return device
    if device.type != "cpu" and not (device.type == "mps" and torch.backends.mps.is_available()):
        raise InputError(
            f'torch has {gpus} CUDA devices here, and no {device!s}: use `device="cpu"` or auto'
        )
    return torch.device(device.type)
