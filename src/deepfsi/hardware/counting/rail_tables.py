"""Tables of rails: what a counter read of each mask, and of its inverse right after it or apart."""

from typing import Literal, get_args

import numpy as np

from deepfsi.base.errors import InputError, check_known

Layout = Literal["columns", "turns", "halves", "single"]
"""Masks and inverses side by side, in turn, all masks before all inverses, or masks alone."""

LAYOUTS = get_args(Layout)
"""Names of the layouts."""


def split_rails(values: np.ndarray, layout: str | None, masks: int | None, name: str) -> np.ndarray:
    """Counts of the rails in the order in which they were shown.

    Parameters
    ----------
    values : array (rows, columns)
        A table as it was read. Of two columns or two rows, the first is that of the masks.
    layout : str or None
        One of `LAYOUTS`; as the shape says unless given.
    masks : int or None
        How many masks there are, where it is fixed already.
    name : str
        What errors call the table.

    Returns
    -------
    array (rails, m)
        Two rails, masks first; one for the layout "single".

    Raises
    ------
    InputError
        If the table does not hold these values, or may be read in two ways.
    """
    if layout is not None:
        check_known("`rails`", layout, LAYOUTS)
    shape = f"{name} has {values.shape[0]} rows and {values.shape[1]} columns"
    upright = values if values.shape[0] >= values.shape[1] else values.T
    wide = upright.shape[1]
    if wide == 2 and layout in (None, "columns"):
        rails = upright.T
    elif wide == 1 and layout not in (None, "columns"):
        row = upright[:, 0]
        if layout != "single" and len(row) % 2:
            raise InputError(f"{shape}: masks and their inverses are an even number of values")
        rails = {
            "turns": row.reshape(-1, 2).T,
            "halves": row.reshape(2, -1),
            "single": row[None],
        }[str(layout)]
    elif wide == 1 and layout is None:
        if masks not in (len(upright), len(upright) / 2):
            raise InputError(
                f"{shape}, in which masks and inverses may stand in several ways: say `rails` "
                "turns, halves or single"
            )
        if masks != len(upright):
            raise InputError(f"{shape}, for {masks} masks: say `rails` turns or halves")
        rails = upright[:, 0][None]
    else:
        raise InputError(
            f"{shape}: give a column of masks and one of inverses (`rails` columns), or all in one "
            "column (`rails` turns, halves or single)"
        )
    if masks is not None and rails.shape[1] != masks:
        raise InputError(
            f"{shape}, which are {rails.shape[1]} masks, and {masks} are needed: give the masks "
            "that were shown, or another layout of `rails`"
        )
    return np.ascontiguousarray(rails)
