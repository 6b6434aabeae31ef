"""Design files, changed and refused."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from deepfsi import Design, InputError


def header_of(path: Path) -> dict[str, Any]:
    """Header of a design file."""
    with safe_open(path, "pt") as file:
        return json.loads(file.metadata()["deepfsi"])


@torch.no_grad()
def looks_at(
    design: Design, scene: np.ndarray, photons: float, seed: int = 0
) -> tuple[np.ndarray, ...]:
    """Masks, mean scenes and chances after each look of adaptive masks at a scene (N,)."""
    generator = torch.Generator().manual_seed(seed)
    looks = design.prior_exposure.look_by_look(torch.from_numpy(scene), photons, generator)
    return tuple(torch.cat(each).numpy() for each in zip(*looks, strict=True))


def rewrite(path: Path, change: Callable[[dict[str, Any], dict[str, torch.Tensor]], None]) -> None:
    """Change the header and the tensors of a design file."""
    header, tensors = header_of(path), load_file(path)
    change(header, tensors)
    save_file(tensors, path, {"deepfsi": json.dumps(header)})


def refused(path: Path, match: str = "not a whole deepfsi design file") -> None:
    """Assert that a file is refused with one line."""
    with pytest.raises(InputError, match=match) as error:
        Design.load(path)
    assert "\n" not in str(error.value)


def assert_refused(design: Design, folder: Path, change: Callable[..., object]) -> None:
    """Assert that the file of a design is refused after a change of its header and tensors."""
    path = design.save(folder / "changed.safetensors")
    rewrite(path, change)
    refused(path)
