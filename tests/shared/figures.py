"""Checks that every figure passes."""

import matplotlib
import numpy as np

from deepfsi.report import style


def words(figure):
    """Texts that are drawn, with their boxes in pixels."""
    figure.draw_without_rendering()
    found = [*figure.texts]
    for legend in figure.legends:
        found += legend.get_texts()
    for ax in figure.axes:
        found += [*ax.texts, ax.title, ax._left_title, ax._right_title]
        if legend := ax.get_legend():
            found += legend.get_texts()
        for axis in (ax.xaxis, ax.yaxis):
            low, high = sorted(axis.get_view_interval())
            margin = 1e-6 * abs(high - low)
            found.append(axis.label)
            for tick in axis.get_major_ticks():
                if low - margin <= tick.get_loc() <= high + margin:
                    found += [tick.label1, tick.label2]
    shown = [text for text in found if text.get_visible() and text.get_text()]
    return [(text, text.get_window_extent()) for text in shown]


def assert_legible(figure, smallest=6.5):
    """No text touches another, leaves the figure, or is smaller than print allows (points)."""
    drawn = words(figure)
    assert len(drawn) > 5
    edge = figure.bbox
    for text, box in drawn:
        assert text.get_fontsize() >= smallest, text.get_text()
        assert box.x0 >= -0.5, text.get_text()
        assert box.y0 >= -0.5, text.get_text()
        assert box.x1 <= edge.x1 + 0.5, text.get_text()
        assert box.y1 <= edge.y1 + 0.5, text.get_text()
    low, high = (np.array([getattr(box, corner) for _, box in drawn]) for corner in ("min", "max"))
    shared = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
    touching = np.argwhere(np.triu((shared >= 1).all(axis=2), 1))
    assert not [(drawn[a][0].get_text(), drawn[b][0].get_text()) for a, b in touching]


def assert_sound(draw):
    """The same figure gives the same files, and settings stay as they were."""
    before = dict(matplotlib.rcParams)
    first, again = style.Figures(), style.Figures()
    assert first.add("a", draw(), "words") == again.add("a", draw(), "words")
    assert first.files == again.files
    assert dict(matplotlib.rcParams) == before
