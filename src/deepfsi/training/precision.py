"""Types of the products of a training: bfloat16 where its rounding stays under the noise."""

import torch

from deepfsi.jobs import Job

BFLOAT16_COUNTS = 2.0**14
"""Largest share of the budget a readout may have for bfloat16 products in training, Φ / readouts.

Rounding to 8 bits is wrong by at most 2⁻⁹ of the count, √2¹⁴ · 2⁻⁹ = 1/4 of its photon noise.
"""

BFLOAT16_WIDTH = 512
"""Units of the widest hidden layer from which a processor is faster with bfloat16 networks.

In float32 an epoch with layers of 512 and 256 takes 1.5 times as long, with 256 and 128 as long,
and with 40 and 128 eight tenths as long (`benchmarks/networks.py`).
"""


def dtypes(job: Job, device: torch.device) -> tuple[torch.dtype, torch.dtype]:
    """Types of the products of a job's masks and of its networks."""
    return product_dtype(job.mask_job(), device), network_dtype(job, device)


def product_dtype(job: Job, device: torch.device) -> torch.dtype:
    """Type of the products of learned masks: bfloat16 where that stays under the readout noise."""
    if job.training.precision == "auto" and not job.exposure.allow_bf16:
        return torch.float32
    return _rounded(job, device)


def network_dtype(job: Job, device: torch.device) -> torch.dtype:
    """Type of the products of the networks in training: bfloat16 for wide ones on a processor."""
    wide = max(job.training.hidden, default=0) >= BFLOAT16_WIDTH
    if not job.exposure.allow_bf16_networks(device.type, wide) or job.training.is_custom:
        return torch.float32
    return _rounded(job, device)


def _rounded(job: Job, device: torch.device) -> torch.dtype:
    """Type whose rounding stays under the readout noise, unless one was asked for."""
    # See `BFLOAT16_COUNTS`. Read noise of σ counts stands in for √count under gaussian noise. The
    # light of all masks may come to the first of nested ones, and with looks to a single readout
    if job.training.precision != "auto":
        return getattr(torch, job.training.precision)
    fast = (
        torch.cuda.is_bf16_supported(including_emulation=False)
        if device.type == "cuda"
        else torch.cpu.get_capabilities().get("avx512_bf16", False)
    )
    readouts = job.exposure.min_lit_masks(job.masks) * (2 if job.optics.rails == "dual" else 1)
    counts = job.exposure.highest(job.photons) / readouts
    limit = {
        "ml_gauss": BFLOAT16_COUNTS,
        "poisson": BFLOAT16_COUNTS,
        "camera": BFLOAT16_COUNTS,
        "gaussian": job.optics.sigma * BFLOAT16_COUNTS**0.5,
    }
    return torch.bfloat16 if fast and counts <= limit.get(job.noise, 0) else torch.float32
