"""Tables and pictures as HTML that needs nothing else, for notebooks and pages."""

import base64
import io
import math
from collections.abc import Sequence
from html import escape

import numpy as np

from deepfsi.base.numeric.intervals import MOST_CLASSES, confusion_shares, frequent_confusions

TINT = "0, 114, 178"
"""Red, green and blue of the cells of a confusion matrix."""

NEGATIVE = (33, 102, 172)
"""Colour of the lowest values of a mask; 0 is white."""

POSITIVE = (178, 24, 43)
"""Colour of the highest values of a mask."""

MOST_MASKS = 12
"""Masks of a picture."""

ACROSS = 6
"""Masks of a row of a picture."""

SIDE = 96
"""Pixels of a mask on the screen."""

WIDTH = 420
"""Width of a curve, pixels."""

HEIGHT = 240
"""Height of a curve, pixels."""

LEFT = 44
"""Room for the numbers on the left of a curve, pixels."""

FOOT = 36
"""Room for the numbers below a curve, pixels."""


def confusion_table(confusion: Sequence[Sequence[int]], classes: Sequence[str]) -> str:
    """Table of the shares of answers (C, C) for each true class; of many, of frequent mistakes."""
    names = [escape(name) for name in classes]
    if len(names) > MOST_CLASSES:
        rows = [
            f"<tr><th scope='row'>{names[i]}</th><td>{names[j]}</td><td>{share:.1%}</td></tr>"
            for i, j, share in frequent_confusions(confusion)
        ]
        heads = "".join(f"<th scope='col'>{head}</th>" for head in ("true", "answered", "share"))
        return f"<table><thead><tr>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    heads = "".join(f"<th scope='col'>{name}</th>" for name in names)
    rows = []
    for name, row in zip(names, confusion_shares(confusion), strict=True):
        cells = "".join(
            f"<td style='background: rgba({TINT}, {0.6 * share:.3f})'>{_percent(share)}</td>"
            for share in row
        )
        rows.append(f"<tr><th scope='row'>{name}</th>{cells}</tr>")
    head = f"<tr><th scope='col'>true \\ answered, %</th>{heads}</tr>"
    return f"<table class='confusion'><thead>{head}</thead><tbody>{''.join(rows)}</tbody></table>"


def _percent(share: float) -> str:
    """Share in per cent; nothing for none, so that mistakes stand out."""
    return "" if share == 0 else "100" if share == 1 else f"{100 * share:.1f}"


def mask_picture(matrix: np.ndarray, shape: tuple[int, ...]) -> str:
    """Picture of the first masks (m, N) of images, or of all bands of masks of spectra."""
    from PIL import Image

    shown = matrix[:MOST_MASKS].reshape(-1, *shape)
    if len(shape) == 1:
        grid = shown
        rows = len(shown) / 6
        columns = ACROSS
    else:
        framed = np.pad(shown, ((0, -len(shown) % min(ACROSS, len(shown))), (0, 1), (0, 1)))
        columns = min(ACROSS, len(shown))
        height, width = framed.shape[1:]
        tiles = framed.reshape(-1, columns, height, width).swapaxes(1, 2)
        grid = tiles.reshape(-1, columns * width)
        rows = len(framed) // columns
    level = grid / (np.abs(grid).max() or 1.0)
    end = np.where(level[..., None] < 0, NEGATIVE, POSITIVE)
    colours = np.rint(255 + (end - 255) * np.abs(level)[..., None]).astype(np.uint8)
    drawn = io.BytesIO()
    Image.fromarray(colours).save(drawn, format="PNG")
    coded = base64.b64encode(drawn.getvalue()).decode()
    size = f"width: {SIDE * columns}px; height: {SIDE * rows:.0f}px; image-rendering: pixelated"
    words = f"the first {len(shown)} of {len(matrix)} masks, red positive, blue negative"
    return f"<img alt='{words}' title='{words}' style='{size}' src='data:image/png;base64,{coded}'>"


def accuracy_curve(points: Sequence[tuple[float, float, float, float]]) -> str:
    """Curve of accuracy against budget: photons, accuracy, and both ends of its interval."""
    ordered = sorted(points)
    first = math.log10(ordered[0][0])
    span = math.log10(ordered[-1][0]) - first or 1.0

    def x(photons: float) -> float:
        return LEFT + 20 + (math.log10(photons) - first) / span * (WIDTH - LEFT - 40)

    def y(accuracy: float) -> float:
        return 10 + (1 - accuracy) * (HEIGHT - FOOT - 10)

    lines = [
        f"<path d='M{LEFT} {y(tick):.1f}H{WIDTH}' stroke='#8884'/>"
        f"<text x='{LEFT - 6}' y='{y(tick) + 4:.1f}' text-anchor='end'>{tick:g}</text>"
        for tick in (0, 0.25, 0.5, 0.75, 1)
    ]
    for photons, accuracy, low, high in ordered:
        lines.append(
            f"<path d='M{x(photons):.1f} {y(low):.1f}V{y(high):.1f}' stroke='rgb({TINT})'/>"
            f"<circle cx='{x(photons):.1f}' cy='{y(accuracy):.1f}' r='3' fill='rgb({TINT})'/>"
            f"<text x='{x(photons):.1f}' y='{HEIGHT - FOOT + 14}' text-anchor='middle'>"
            f"{photons:.3g}</text>"
        )
    way = " ".join(f"{x(photons):.1f},{y(accuracy):.1f}" for photons, accuracy, *_ in ordered)
    lines.append(f"<polyline points='{way}' fill='none' stroke='rgb({TINT})'/>")
    lines.append(f"<text x='{WIDTH / 2:.0f}' y='{HEIGHT - 4}' text-anchor='middle'>photons</text>")
    look = "font: 12px sans-serif; fill: currentColor"
    return (
        f"<svg role='img' aria-label='accuracy against photons' width='{WIDTH}' "
        f"height='{HEIGHT}' style='{look}'>{''.join(lines)}</svg>"
    )


def loss_curve(epochs: Sequence[tuple[int, float, float | None]]) -> str:
    """Curves of the loss of a training over its epochs."""
    first = epochs[0][0]
    span = epochs[-1][0] - first or 1
    highest = max(loss for _, *losses in epochs for loss in losses if loss is not None) or 1.0

    def x(number: int) -> float:
        return LEFT + 20 + (number - first) / span * (WIDTH - LEFT - 40)

    def y(loss: float) -> float:
        return 10 + (1 - max(loss, 0.0) / highest) * (HEIGHT - FOOT - 10)

    lines = [
        f"<path d='M{LEFT} {y(tick):.1f}H{WIDTH}' stroke='#8884'/>"
        f"<text x='{LEFT - 6}' y='{y(tick) + 4:.1f}' text-anchor='end'>{tick:.2g}</text>"
        for tick in (0.0, highest / 2, highest)
    ]
    for number in sorted({first, epochs[-1][0]}):
        lines.append(
            f"<text x='{x(number):.1f}' y='{HEIGHT - FOOT + 14}' text-anchor='middle'>{number}"
            "</text>"
        )
    curves = [("training", "stroke-dasharray='4 3'"), ("held-out scenes", "")]
    for column, (title, dashes) in enumerate(curves):
        points = [
            f"{x(number):.1f},{y(loss):.1f}"
            for number, *losses in epochs
            if (loss := losses[column]) is not None
        ]
        if points:
            way = " ".join(points)
            lines.append(
                f"<polyline points='{way}' fill='none' stroke='rgb({TINT})' {dashes}>"
                f"<title>{title}</title></polyline>"
            )
    words = "epoch (dashed: loss of training; solid: of held-out scenes)"
    lines.append(f"<text x='{WIDTH / 2:.0f}' y='{HEIGHT - 4}' text-anchor='middle'>{words}</text>")
    look = "font: 12px sans-serif; fill: currentColor"
    return (
        f"<svg role='img' aria-label='loss over epochs' width='{WIDTH}' "
        f"height='{HEIGHT}' style='{look}'>{''.join(lines)}</svg>"
    )
