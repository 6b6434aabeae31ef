"""Defaults of torch, whatever the surrounding program set, and the device."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import torch

from deepfsi.base.errors import InputError


@contextmanager
def library_defaults(grad: bool | None = None) -> Iterator[None]:
    """Context, or decorator, in which a user's settings of torch change no result."""
    with ExitStack() as stack:
        recorded = torch.is_grad_enabled() if grad is None else grad
        if torch.is_inference_mode_enabled():
            stack.enter_context(torch.inference_mode(False))  # this records gradients again
        stack.enter_context(torch.set_grad_enabled(recorded))
        stack.callback(torch.set_float32_matmul_precision, torch.get_float32_matmul_precision())
        torch.set_float32_matmul_precision("highest")
        for device in ("cpu", "cuda"):
            if torch.is_autocast_enabled(device):
                stack.enter_context(torch.autocast(device, enabled=False))
        if torch.get_default_device().type != "cpu":  # a context for a device slows every call
            stack.enter_context(torch.device("cpu"))
        stack.callback(torch.set_default_dtype, torch.get_default_dtype())
        torch.set_default_dtype(torch.float32)
        yield


def torch_device(name: Any) -> torch.device:
    """Device that torch computes on."""
    gpus = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if name == "auto":
        return torch.device("cuda" if gpus else "cpu")
    try:
        device = torch.device(name)
    except (RuntimeError, TypeError):
        raise InputError(
            f"unknown device {str(name)!r}: choose auto, cpu, cuda, cuda:1 or mps"
        ) from None
    if device.type == "cuda" and (device.index or 0) < gpus:
        return device
    if device.type != "cpu" and not (device.type == "mps" and torch.backends.mps.is_available()):
        raise InputError(
            f'torch has {gpus} CUDA devices here, and no {device!s}: use `device="cpu"` or auto'
        )
    return torch.device(device.type)
