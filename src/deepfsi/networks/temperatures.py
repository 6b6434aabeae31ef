"""Temperatures of many exposures at once, with gradients and in graphs."""

import numpy as np
import torch
from torch import Tensor

from deepfsi.designfile.temperatures import Temperatures


def temperatures_at(fitted: Temperatures, place: Tensor | int, photons: Tensor) -> Tensor:
    """Temperatures (..., 1) at places among the stops, from 0, and at budgets (..., 1)."""
    start = np.log(fitted.budgets[0])
    step = np.log(fitted.budgets[1] / fitted.budgets[0])
    level = (photons.log() - start) / step
    logs = torch.from_numpy(fitted.logs).to(level)
    rows = _hats(torch.as_tensor(place).to(level), len(logs)) @ logs
    log = (rows * _hats(level, logs.shape[1])).sum(dim=-1, keepdim=True)
    return (log - level.clamp(max=0) * step).exp()


def stop_temperatures(fitted: Temperatures, photons: float) -> np.ndarray:
    """Temperatures (K,) after each number of masks or looks at a budget."""
    places = torch.arange(len(fitted.logs))
    budget = torch.tensor([photons], dtype=torch.double)
    every = temperatures_at(fitted, places[:, None], budget.expand(len(places), 1))
    return every.squeeze(1).numpy()


def _hats(place: Tensor, count: int) -> Tensor:
    """Weights (..., count) of linear interpolation between equidistant values; ends stay."""
    # place (..., 1) or ()
    away = place.clamp(0, count - 1) - torch.arange(count).to(place)
    return (1 - away.abs()).relu()
