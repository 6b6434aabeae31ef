"""Designs as operators of other libraries, which make pictures of counts.

The counts of an exposure are noise about A x + dark counts: A (k, N) is linear in the reflectance
x (N,), and its k readouts are those of `Design.expose`, flattened.
"""

from typing import TYPE_CHECKING, Any

import torch
from scipy.sparse.linalg import LinearOperator, aslinearoperator
from torch import Tensor

from deepfsi.camera.light import check_budget
from deepfsi.design.design import Design
from deepfsi.physics.noise import NoiseFunction, noise_of
from deepfsi.physics.surroundings import library_defaults

if TYPE_CHECKING:
    from deepinv.physics import LinearPhysics


@library_defaults(grad=False)
def _sensing_matrix(design: Design, photons: float | None) -> Tensor:
    """Expected counts (k, N) of each pixel of reflectance 1."""
    design.exposure.check("masks")
    budget = design.info["job"]["photons"] if photons is None else check_budget(photons)
    pixels = torch.eye(design.rails.difference.shape[-1])
    rates = design.mask_exposure.rates(design.scanner(), pixels) * budget
    return rates.flatten(1).T.contiguous()


def to_linear_operator(design: Design, photons: float | None = None) -> LinearOperator:
    """Expected counts of a design as a linear operator of SciPy; PyLops takes it, too.

    Parameters
    ----------
    design : Design
        Of masks that are known before an exposure: learned, or your own by `design_of`.
    photons : float, optional
        Budget Φ of an exposure, counts. Default: that of the training.

    Returns
    -------
    LinearOperator, shape (k, N)
        Expected counts of the k readouts, without dark counts, of reflectances (N,).

    Raises
    ------
    InputError
        If masks are made during the exposure, or the budget is not above 0.

    Examples
    --------
    >>> import deepfsi
    >>> from deepfsi.adapters import to_linear_operator
    >>> few = deepfsi.Training(epochs=1)
    >>> design = deepfsi.learn("digits", photons=1e4, masks=6, design="pca", training=few)
    >>> to_linear_operator(design).shape
    (6, 64)
    """
    return aslinearoperator(_sensing_matrix(design, photons).double().cpu().numpy())


def to_deepinv(
    design: Design, photons: float | None = None, noise: str | NoiseFunction | None = None
) -> "LinearPhysics":
    """Masks, light law and noise of a design as a linear physics of deepinv.

    Parameters
    ----------
    design, photons
        As for `to_linear_operator`.
    noise : str or callable, optional
        As for `Scanner`, with the camera's read noise and dark counts. Default: the camera's.

    Returns
    -------
    deepinv.physics.LinearPhysics
        From images (B, 1, H, W) to counts (B, k), by torch's global generator.

    Raises
    ------
    InputError
        As for `to_linear_operator`.

    Examples
    --------
    >>> from deepfsi.adapters import to_deepinv
    >>> physics = to_deepinv(design)  # doctest: +SKIP
    >>> pictures = physics.A_dagger(counts)  # doctest: +SKIP
    """
    from deepinv.physics import LinearPhysics, NoiseModel

    image = (1, *design.image_shape)
    physics: Any = LinearPhysics(
        A=lambda x, **_: x.flatten(1) @ physics.matrix.T,
        A_adjoint=lambda y, **_: (y @ physics.matrix).unflatten(1, image),
        img_size=image,
        noise_model=NoiseModel(
            lambda y: physics.scanner.read(y.unflatten(1, (design.rails.count, -1))).flatten(1)
        ),
    )
    physics.register_buffer("matrix", _sensing_matrix(design, photons))
    physics.scanner = design.mask_exposure.scanner(noise_of(design.camera, noise))
    return physics
