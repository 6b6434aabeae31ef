"""Names of light laws, rails, readouts and scales, which optics, hardware and files share."""

from typing import Literal

Light = Literal["column", "equal-dwell", "free-dwell", "two-arm"]
"""Name of a light law, see `optics.constraints`."""

RailsKind = Literal["dual", "single"]
"""Rails of each mask: positive and negative part, or one non-negative frame."""

Readout = Literal["difference", "both"]
"""What a network reads of two rails."""

Scale = Literal["each", "common"]
"""Whether each feature has a standard deviation of its own, or all a common one."""
