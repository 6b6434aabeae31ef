"""Types of records of PTU files, as PicoQuant describes them."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Kind:
    """A type of record.

    Attributes
    ----------
    name : str
        Device and mode.
    code : int
        Of the tag `TTResultFormat_TTTRRecType`.
    mode : {"T2", "T3"}
        Times count ticks of the device, or periods of the sync.
    shift : int
        Bits below the channel field.
    time_bits : int
        Lowest bits, which hold the time.
    wrap : int
        Ticks of an overflow.
    counted : bool
        Whether one record can stand for many overflows, their number in its time field.
    first, inputs : int
        Channel field of the first input, and how many inputs there can be.
    """

    name: str
    code: int
    mode: Literal["T2", "T3"]
    shift: int
    time_bits: int
    wrap: int
    counted: bool
    first: int
    inputs: int

    @property
    def time_mask(self) -> int:
        """Bits of the time."""
        return (1 << self.time_bits) - 1


def _hydra(name: str, code: int, mode: Literal["T2", "T3"], *, old: bool = False) -> Kind:
    """Type of record of a HydraHarp, or of a later device; old ones count no overflows."""
    bits = 25 if mode == "T2" else 10
    wrap = 33_552_000 if old and mode == "T2" else 1 << bits
    return Kind(f"{name} {mode}", code, mode, 25, bits, wrap, not old, 0, 64)


PICOHARP_T2 = Kind("PicoHarp 300 T2", 0x00010203, "T2", 28, 28, 210_698_240, False, 0, 5)
"""Record of a PicoHarp 300 in T2 mode."""

PICOHARP_T3 = Kind("PicoHarp 300 T3", 0x00010303, "T3", 28, 16, 65_536, False, 1, 4)
"""Record of a PicoHarp 300 in T3 mode."""

GENERIC_T2 = _hydra("Generic", 0x00010207, "T2")
"""Record of a recent device in T2 mode."""

KINDS = {
    kind.code: kind
    for kind in (
        PICOHARP_T2,
        PICOHARP_T3,
        _hydra("HydraHarp V1", 0x00010204, "T2", old=True),
        _hydra("HydraHarp V1", 0x00010304, "T3", old=True),
        _hydra("HydraHarp V2", 0x01010204, "T2"),
        _hydra("HydraHarp V2", 0x01010304, "T3"),
        _hydra("TimeHarp 260 N", 0x00010205, "T2"),
        _hydra("TimeHarp 260 N", 0x00010305, "T3"),
        _hydra("TimeHarp 260 P", 0x00010206, "T2"),
        _hydra("TimeHarp 260 P", 0x00010306, "T3"),
        GENERIC_T2,
        _hydra("Generic", 0x00010307, "T3"),
    )
}
"""Types of records by code."""
