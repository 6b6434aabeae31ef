"""Bounds of how well values can be estimated from the counts of a design.

`linear_bound` is the error of the best linear estimator. With f the expected features of a scene, θ
its values, V the mean variance of the features' noise, and covariances over scenes,

    E² = diag(C_θθ − C_θf (C_ff + V)⁻¹ C_fθ).

It is the Bayesian Cramér–Rao bound (H. L. van Trees) where θ and f are jointly normal and the noise
is normal with this V. Elsewhere a network may do better, and a linear estimator never.

`cramer_rao` is the bound of unbiased estimators of values θ on which a scene depends in a known
way, x(θ). With r_i the photons that readout i expects and F_i the information of its counts about
them, the covariance of any unbiased estimator is at least the inverse of

    I_kl = Σ_i F_i (∂r_i / ∂θ_k) (∂r_i / ∂θ_l),     F_i = 1 / r_i under photon noise.
"""

from typing import Any

import numpy as np
import torch

from deepfsi.base.errors import InputError
from deepfsi.camera.light import check_budget
from deepfsi.datasets.dataset import Dataset
from deepfsi.design.design import Design
from deepfsi.physics.scanner import Scanner
from deepfsi.physics.surroundings import library_defaults


@library_defaults()
def linear_bound(
    design: Design, scanner: Scanner, data: Dataset, photons: float
) -> list[float] | None:
    """Root mean squared error (q,) of the best linear estimator of the values of test scenes.

    None of exposures whose dwells or places are drawn, and of a noise of a user's own.
    """
    if not (_fixed(design) and scanner.noise.has_moments):
        return None
    with torch.no_grad():
        rates = photons * design.rates(scanner, torch.from_numpy(np.asarray(data.x_test)))
        means, noise = (each.double().cpu().numpy() for each in scanner.moments(rates))
    joint = np.cov(np.concatenate([means, data.y_test], axis=1).T, ddof=0)
    features = slice(means.shape[1])
    values = slice(means.shape[1], None)
    across = joint[features, values]
    spread = joint[features, features] + np.diag(noise.mean(axis=0))
    weights = np.linalg.pinv(spread, hermitian=True) @ across
    left = np.diag(joint[values, values] - across.T @ weights)
    return np.sqrt(np.clip(left, 0, None)).tolist()


@library_defaults()
def cramer_rao(
    design: Design, scenes: Any, derivatives: Any, photons: float, scanner: Scanner | None = None
) -> np.ndarray:
    """Least standard deviation (n, q) of unbiased estimates of values that scenes depend on.

    Parameters
    ----------
    design : Design
    scenes : array, shape (n, N)
        Reflectance x(θ).
    derivatives : array, shape (n, q, N)
        ∂x / ∂θ at these scenes, reflectance per unit of each value.
    photons : float
        Budget Φ.
    scanner : Scanner, optional
        Of the design, with other than photon noise.

    Raises
    ------
    InputError
        If shapes do not fit each other or the design, or the exposure draws dwells or places.

    Examples
    --------
    >>> import deepfsi, numpy
    >>> x, dark = numpy.full((1, 64), 0.5), deepfsi.Training(epochs=1)
    >>> design = deepfsi.learn("digits", photons=1e4, masks=8, design="pca", training=dark)
    >>> derivatives = x[:, None] / 0.5  # by its brightness
    >>> deepfsi.evaluation.bounds.cramer_rao(design, x, derivatives, 1e4).shape
    (1, 1)
    """
    if not _fixed(design):
        raise InputError("this exposure draws its dwells or places, and has no such bound")
    scanner = scanner or design.scanner()
    if not scanner.noise.has_moments:
        raise InputError("counts of this noise are correlated, or not known: it has no such bound")
    x, slopes = (torch.from_numpy(np.asarray(each, np.float32)) for each in (scenes, derivatives))
    pixels = int(np.prod(design.image_shape))
    if x.shape != (len(x), pixels) or slopes.shape != (len(x), slopes.shape[1], pixels):
        raise InputError(
            f"scenes of shape {tuple(x.shape)} and derivatives of shape {tuple(slopes.shape)}: "
            f"give (n, {pixels}) and (n, values, {pixels})"
        )
    budget = check_budget(photons)
    with torch.no_grad():
        rates = budget * design.rates(scanner, x)
        information = scanner.information(rates).double().flatten(1)
        changes = (budget * design.rates(scanner, slopes)).double().flatten(2)
    fisher = torch.einsum("ni,nki,nli->nkl", information, changes, changes)
    values, vectors = torch.linalg.eigh(fisher)
    # infinite where the counts tell nothing of a value
    informed = values > values.amax(dim=-1, keepdim=True) * 1e-12
    inverse = torch.where(informed, 1 / values.where(informed, torch.ones_like(values)), torch.inf)
    squares = vectors.square()
    variances = (squares * inverse.unsqueeze(-2)).where(squares > 1e-12, 0.0).sum(dim=-1)
    return variances.sqrt().cpu().numpy()


def _fixed(design: Design) -> bool:
    """True of an exposure whose expected counts follow from the scene alone."""
    return design.exposure.comparable
