"""Pictures from tables of counts behind known masks, with a verdict on the light."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepfsi.cli import common, options, paths

if TYPE_CHECKING:
    from deepfsi.hardware.pictures import Excess, RailSums, TablePictures


def camera_picture(
    tables: Annotated[
        list[str],
        typer.Argument(
            metavar="COUNTS...",
            help="table of counts behind each mask, .npy .csv .mat .parquet .h5 (FILE:VARIABLE); "
            "several of the same masks are compared",
        ),
    ],
    masks: Annotated[
        str,
        typer.Option(
            help="hadamard-natural (of scipy.linalg.hadamard), hadamard-sequency or "
            "hadamard-walsh, hadamard (of the design), raster; wavelet-haar-4 and the like, of "
            "coefficients; or a file of masks (m, N) or (m, H, W)"
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="folder of the pictures, new")],
    size: Annotated[
        str | None, typer.Option(help="HEIGHTxWIDTH of the picture; a square unless given")
    ] = None,
    rails: Annotated[
        str | None,
        typer.Option(
            help="mask and inverse as two columns, in one column in turns or as two halves, or "
            "single masks: columns, turns, halves, single; by the shape unless given"
        ),
    ] = None,
    exposures: Annotated[
        str | None, typer.Option(help="time of a picture in each table, such as 20ms,40ms")
    ] = None,
    block: Annotated[
        int | None,
        typer.Option(min=2, help="pictures that were uploaded and shown at a time, such as 64"),
    ] = None,
    compare: Annotated[
        str | None,
        typer.Option(help="picture of another camera, FILE or FILE:VARIABLE, to compare with"),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Draw pictures from tables of counts, and say whether the light was steady and Poisson.

    A mask and its inverse together see all the light. So their sums have one mean, and scatter as
    Poisson counts do if the light is steady. Any excess is measured, and the command says where in
    the sequence it lies. Of several tables it says what is alike in them.

    Example: deepfsi camera picture counts.npy --masks hadamard-natural -o picture
    """
    paths.check_new_folder(out)
    import numpy as np

    from deepfsi.base import new_folder
    from deepfsi.hardware.pictures import TableMasks, compare_picture, read_pictures
    from deepfsi.report import pictures_figure, rail_light_figure

    times = None if exposures is None else exposures.split(",")
    settings = TableMasks(
        masks,
        options.size_of(size),
        rails,
        None if times is None else tuple(options.seconds("exposures", one) for one in times),
        block,
    )
    found = read_pictures(tables, settings)
    pictures, names = found.pictures / _scales(found), list(_names(found, times))
    agreement: Any = ()
    if compare is not None:
        beside, agreement = compare_picture(found, compare)
        pictures = np.concatenate([pictures, beside[None] / np.ravel(_scales(found))[0]])
        names.append("compared with")
    told = found.as_dict() | {"agreement": agreement}
    with new_folder(out) as draft:
        np.save(draft / "pictures.npy", found.pictures)
        common.save_figure(pictures_figure(pictures, names), draft / "picture.png")
        if found.sums is not None and found.fine is not None:
            common.save_figure(
                rail_light_figure(found.sums, found.fine, names[: len(tables)]), draft / "light.png"
            )
        (draft / "verdict.json").write_text(json.dumps(_plain(told), indent=1))
    if as_json:
        common.print_json("camera.picture", {"folder": str(out), **_plain(told)})
        return
    for line in [*_picture_lines(found), *_light_lines(found)]:
        print(line)
    for name, one in zip(found.names, agreement, strict=False):
        print(
            f"{name} beside {compare}: correlation {one['correlation']:.3f}, residual "
            f"{one['residual']:.2f} of its contrast"
        )
    print(f"pictures: {out}")


def _scales(found: "TablePictures") -> Any:
    """Divisors that bring pictures to one brightness: of counts at several exposures."""
    import numpy as np

    scale = np.abs(found.pictures).mean(axis=(1, 2), keepdims=True)
    return np.where(scale > 0, scale, 1.0) if len(scale) > 1 else 1.0


def _names(found: "TablePictures", times: list[str] | None) -> tuple[str, ...]:
    """Captions of pictures: exposures, if they differ, or the names of files."""
    if times is not None and len(set(times)) == len(times):
        return tuple(times)
    return found.names


def _plain(value: Any) -> Any:
    """Values as JSON holds them: no NaN."""
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and value != value else value


def _picture_lines(found: "TablePictures") -> list[str]:
    shape = "x".join(map(str, found.pictures.shape[1:]))
    lines = [f"{common.several(len(found.names), 'picture')} of {shape}"]
    if found.correlations:
        lines.append(f"pictures agree: correlation {_range(found.correlations, '.2f')}")
    for name, one in zip(found.names, found.wavelets or (), strict=False):
        lines.append(f"{name}: {one['measured']:.0%} of the coefficients were measured")
        if one["level"] and one["variance_over_poisson"]:
            ratio = one["variance_over_poisson"]
            lines.append(
                f"  details of level {one['level']} scatter with at most {min(ratio):.3g} to "
                f"{max(ratio):.3g} times the variance of Poisson counts, if a unit of the table "
                "were a count (tenths of like light)"
            )
    return lines


def _light_lines(found: "TablePictures") -> list[str]:
    lines = [f"note: {found.note}"] if found.note else []
    light = found.light
    if light is not None:
        lines += [*_verdict_lines(found.names, light), *_cause_lines(light)]
    if found.rates is not None and found.rate_errors is not None:
        mean = sum(found.rates) / len(found.rates)
        worst = max(abs(rate / mean - 1) for rate in found.rates)
        lines.append(
            f"mean picture: {_range(found.rates, '.4g')} counts a second, {worst:.1%} from their "
            f"mean at most (photon noise {max(found.rate_errors):.2%})"
        )
    if found.on is not None and found.off is not None and found.uniform is not None:
        dark = ", ".join(f"{one:g} ({low:.1f} to {high:.1f})" for one, low, high in found.off)
        lines += [
            f"all ON: {', '.join(f'{one:g}' for one in found.on)} counts; all OFF: {dark}",
            f"all ON and all OFF together have {_range(found.uniform, '.2f')} times the light of "
            "a mask and its inverse in the mean: 1 if no light is lost",
        ]
    return lines


def _verdict_lines(names: tuple[str, ...], light: "RailSums") -> list[str]:
    lines = [
        "these counts are Poisson, as far as they tell"
        if light.poisson
        else "THESE COUNTS ARE NOT POISSON"
    ]
    for name, run in zip(names, light.runs, strict=True):
        lines.append(
            f"  {name}: sums of a mask and its inverse, {run.mean:.0f} in the mean, scatter by "
            f"{run.spread:.1%} where Poisson allows {run.allowed:.1%} (chi2/dof {run.chi2:.3g}, "
            f"p {_chance(run.chance)}); excess {_excess(run.excess)}"
        )
    if light.common is None:
        return lines
    own = ", ".join(_excess(one) for one in light.own)
    fano = [1 + one.variance * run.mean for one, run in zip(light.own, light.runs, strict=True)]
    return [
        *lines,
        f"  alike in all tables (r {_range(light.correlations, '.2f')}): {_excess(light.common)}, "
        "of the masks or the sequence",
        f"  of each table by itself: {own}: variance {_range(fano, '.2f')} times Poisson's",
        f"  of single pictures: {', '.join(_excess(one) for one in light.pictures)}; the virtual "
        f"camera draws it with fluctuation = {max(one.spread for one in light.pictures):.2g}",
        f"  between tables: chi2/dof of single counts {light.chi2_counts:.2f} "
        f"(p {_chance(light.chance_counts or 0)}), of sums {light.chi2_sums:.2f}",
        f"  autocorrelation of what differs, at a lag of 1 pair {light.own_autocorrelation[0]:.2f}"
        f", of 8 pairs {light.own_autocorrelation[3]:.2f}",
    ]


def _cause_lines(light: "RailSums") -> list[str]:
    words = {
        "fineness": "masks of like fineness",
        "sequence": "pictures before and after",
        "block": "the block",
        "place in block": "the place in the block",
    }
    lines = []
    for name, cause in light.causes.items():
        said = f"{max(cause.share, 0):.0%} of the scatter (p {_chance(cause.chance)})"
        rest = "" if cause.rest is None else f"; {max(cause.rest, 0):.0%} of what is left then"
        lines.append(f"  predicted by {words[name]}: {said}{rest}")
    return lines


def _excess(excess: "Excess") -> str:
    low, high = (max(end, 0.0) ** 0.5 for end in (excess.low, excess.high))
    return f"{excess.spread:.1%} ({low:.1%} to {high:.1%})"


def _chance(chance: float) -> str:
    return f"{chance:.1g}" if chance > 1e-300 else "< 1e-300"


def _range(values: Any, form: str) -> str:
    ends = [format(end, form) for end in (min(values), max(values))]
    return " to ".join(dict.fromkeys(ends))
