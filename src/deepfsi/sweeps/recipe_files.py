"""Recipe files: one recipe or several parts of a study, and a coarse version of each.

Settings at the top hold for every part. `[parts.NAME]` overrides them in one part, `[quick]` in the
coarse version, and `[parts.NAME.quick]` in the coarse version of one part. Tables are merged.
"""

from collections.abc import Mapping
from typing import Any

from deepfsi.errors import InputError, closest

Settings = dict[str, Any]
"""Fields of a recipe, as TOML gives them."""


def parts(file: Mapping[str, Any], quick: bool = False) -> dict[str, Settings]:
    """Settings of each recipe of a file, by the name of its part.

    Parameters
    ----------
    file : mapping
        A whole recipe file.
    quick : bool
        The coarse versions.

    Returns
    -------
    dict
        A file without parts has one recipe, named "".

    Raises
    ------
    InputError
        If `parts` or `quick` are something else than tables, or nothing says what a coarse version
        is.
    """
    common = {name: value for name, value in file.items() if name not in ("parts", "quick")}
    coarse, own = _table(file, "quick"), _table(file, "parts") or {"": {}}
    found = {}
    for name in own:
        part = _table(own, name)
        quick_part = _table(part, "quick")
        settings = _merged(common, {key: part[key] for key in part if key != "quick"})
        if quick:
            if not (coarse or quick_part):
                raise InputError("this recipe has no [quick] table: run it whole")
            settings = _merged(_merged(settings, coarse), quick_part)
        found[name] = settings
    return found


def only(file: Mapping[str, Any], part: str | None = None, quick: bool = False) -> Settings:
    """Settings of one recipe of a file.

    Parameters
    ----------
    file : mapping
        A whole recipe file.
    part : str, optional
        Needed where the file has several.
    quick : bool
        The coarse version.

    Raises
    ------
    InputError
        If the file has no such part, or parts and none is named.
    """
    found = parts(file, quick)
    if part is None and "" not in found:
        raise InputError(
            f"the recipe has several parts, {', '.join(found)}: name one by the option --part of "
            "deepfsi sweep"
        )
    if part is not None and "" in found:
        raise InputError(f"the recipe has no parts: leave --part {part} out")
    if (part or "") not in found:
        raise InputError(f"the recipe has no part {part!r}: {closest(str(part), found)}")
    return found[part or ""]


def _table(file: Mapping[str, Any], name: str) -> Settings:
    table = file.get(name, {})
    if not isinstance(table, dict):
        raise InputError(f"{name} of a recipe is a table, not {table!r}: write [{name}]")
    return table


def _merged(settings: Settings, changes: Settings) -> Settings:
    whole = dict(settings)
    for name, value in changes.items():
        here = whole.get(name)
        if isinstance(here, dict) and isinstance(value, dict):
            value = _merged(here, value)
        whole[name] = value
    return whole
