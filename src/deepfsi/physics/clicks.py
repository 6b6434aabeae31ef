"""Clicks at other light than the training's, as the features of a network that knows that light.

Photon counts are divided by the budget: then features of any light have the mean of the training.
Clicks are not in proportion to the light. A readout of G gates with r⁺ and r⁻ expected photons a
gate on its two rails has, at q times the light of the training, the mean and the noise

    μ(q) = G (e^(−q r⁻) − e^(−q r⁺)),    ν(q) = G Σ± e^(−q r±) (1 − e^(−q r±)) .

So the clicks y are read as μ(1) + (y − μ(q)) √(ν(1) / ν(q)). At the light of the training that is y
itself. The photons r± are those of the mean scene: of the mean M of y / G and the mean S of all
photons a gate, both over training scenes, r⁺ − r⁻ = 2 arsinh(M e^(S/2) / 2).
"""

import torch
from torch import Tensor

from deepfsi.base.errors import Message

LEAST_NOISE = 1e-30
"""Least ν over G, that of a readout that is dark."""

MOST_GAIN = 100.0
"""Largest factor of clicks, where nearly every gate clicks, or none, and clicks tell nothing."""

MOST_CLICKS = 0.95
"""Share of gates that click above which one is told: with r photons in a gate the information on
log r is r² e⁻ʳ / (1 − e⁻ʳ), highest at a share of 0.80, and 0.73 of that at 0.95."""


def full_gates(share: float, photons: float) -> str | None:
    """Remark on clicks in nearly all gates."""
    if share <= MOST_CLICKS:
        return None
    return Message(
        "at {given:.3g} photons {share:.0%} of the gates click, which tells little of a "
        "scene: give more {gates}, or a lower {photons}",
        setting=("gates", "photons"),
        given=photons,
        share=share,
    )


def to_training_light(
    ratio: Tensor | float, mean: Tensor, photons: Tensor, gates: int
) -> tuple[Tensor, Tensor]:
    """Gain and offset (..., k) that make of clicks those at the light of the training.

    `ratio` (..., 1) is the light over that of the training; `mean` (k,) and `photons` (k,) are
    clicks and photons in the mean over training scenes.
    """
    both = photons / gates
    apart = 2 * torch.asinh(mean / gates * (both / 2).exp() / 2)
    rates = [((both + sign * apart) / 2).clamp(min=0) for sign in (1, -1)]

    def moments(q: Tensor | float) -> tuple[Tensor, Tensor]:
        parts = [q * rate for rate in rates]
        # 1 - e^(-x) to all digits, of what an ONNX graph knows
        halves = [(part / 2).tanh() for part in parts]
        plus, minus = (2 * half / (1 + half) for half in halves)
        noise = plus * (-parts[0]).exp() + minus * (-parts[1]).exp()
        return gates * (plus - minus), noise.clamp(min=LEAST_NOISE)

    trained, noise = moments(1.0)
    now, noise_now = moments(ratio)
    gain = (noise / noise_now).sqrt().clamp(max=MOST_GAIN)
    return gain, trained - now * gain
