"""Exposures of images patch by patch: all square patches of an image share one set of masks."""

from dataclasses import field
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass as validated
from torch import Tensor

from deepfsi.design.exposure import STRICT, ExposureKind
from deepfsi.errors import InputError
from deepfsi.optics.constraints import Light


def cut(scenes: Tensor, image_shape: tuple[int, ...], side: int) -> Tensor:
    """Patches (..., P, side²) of images (..., H · W), row by row.

    Parameters
    ----------
    scenes : tensor, shape (..., H · W)
    image_shape : tuple of int
        H and W.
    side : int
        Of a patch, pixels.

    Raises
    ------
    InputError
        If the sides of the image are no multiples of the patch's.
    """
    height, width = image_shape
    if height % side or width % side:
        raise InputError(
            f"images of {height}x{width} pixels cannot be cut in patches of {side}x{side}: give a "
            "side that divides both"
        )
    blocks = scenes.unflatten(-1, (height // side, side, width // side, side))
    return (
        blocks.transpose(-3, -2)
        .flatten(-2)
        .flatten(-3, -2)
        .reshape(*scenes.shape[:-1], -1, side * side)
    )


@validated(frozen=True, config=STRICT)
class PatchExposure(ExposureKind):
    """Exposure of fixed dwells, with a detector for each patch of an image.

    Features have the shape (..., P, m), and a budget is of the whole image.

    Attributes
    ----------
    side : int
        Of a patch, pixels.
    """

    side: Annotated[int, Field(ge=1)]
    kind: Literal["patches"] = field(default="patches", kw_only=True)

    def check(self, rails: Tensor, light: Light, image_shape: tuple[int, ...]) -> None:
        """Raise `ValueError` unless rails (2 or 1, m, N) are of patches of such images."""
        height, width = image_shape
        if rails.shape[-1] != self.side**2 or height % self.side or width % self.side:
            raise ValueError("masks are not of a patch")

    def mask_shape(self, image_shape: tuple[int, ...]) -> tuple[int, ...]:
        """Shape of a mask, that of a patch."""
        return self.side, self.side

    def cut(self, scenes: Tensor, image_shape: tuple[int, ...]) -> Tensor:
        """Patches (..., P, N) of images (..., H · W), as the masks see them."""
        return cut(scenes, image_shape, self.side)

    def check_fixed(self) -> None:
        """Raise `InputError`: a sequence of patterns is for whole images."""
        raise InputError(
            "this design is of image patches, each with a detector of its own, which a fixed "
            "sequence of patterns for one detector or one graph cannot: use Design.classify"
        )
