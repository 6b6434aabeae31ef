"""Pickles of CIFAR-10's Python archive, read without calling anything that they name.

Such a pickle holds a dict of bytes, lists, integers and one array of bytes. The few names that it
refers to are replaced by stand-ins; any other name is an error, so that nothing is ever called.
"""

import io
import pickle
from typing import Any

import numpy as np
import numpy.typing as npt

from deepfsi.errors import InputError


class _ByteType:
    """Stands in for numpy's dtype of unsigned bytes, the only one allowed."""

    def __init__(self, kind: object, *_: object) -> None:
        if kind not in ("u1", b"u1"):
            raise pickle.UnpicklingError(f"an array of {kind!r}, not of bytes")

    def __setstate__(self, _: object) -> None:
        """Bytes have no order: nothing to keep."""


class _Array:
    """Stands in for numpy's ndarray while it is put together."""

    values: npt.NDArray[np.uint8]

    def __setstate__(self, state: Any) -> None:
        _, shape, kind, column_major, content = state
        if not isinstance(kind, _ByteType) or column_major or not isinstance(content, bytes):
            raise pickle.UnpicklingError("an array of something other than bytes")
        self.values = np.frombuffer(content, np.uint8).reshape(shape)


_STAND_INS = {
    ("numpy.core.multiarray", "_reconstruct"): lambda *_: _Array(),
    ("numpy._core.multiarray", "_reconstruct"): lambda *_: _Array(),
    ("numpy", "ndarray"): _Array,
    ("numpy", "dtype"): _ByteType,
}
"""Stand-ins for the names that a pickle may refer to."""


class _Reader(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _STAND_INS:
            raise pickle.UnpicklingError(f"it asks for {module}.{name}")
        return _STAND_INS[module, name]


def read_batch(content: bytes, where: str) -> tuple[npt.NDArray[np.uint8], list[int]]:
    """Pixels (n, 3072) and labels of one pickled batch; messages call it `where`.

    Raises `InputError` if it is damaged, or holds anything but that.
    """
    try:
        batch = _Reader(io.BytesIO(content), encoding="bytes").load()
        pixels, labels = batch[b"data"].values, batch[b"labels"]
        if not (isinstance(labels, list) and all(type(label) is int for label in labels)):
            raise pickle.UnpicklingError("its labels are no list of integers")
        if pixels.shape != (len(labels), 3072):
            raise pickle.UnpicklingError(f"pixels {pixels.shape} for {len(labels)} labels")
    except Exception as error:  # a damaged pickle raises almost anything
        raise InputError(
            f"{where} is no batch of CIFAR-10 ({error}); replace it with the original"
        ) from error
    return pixels, labels
