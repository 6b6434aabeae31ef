"""Figures of the tutorial and the gallery have the style of the package, and words for a phone.

A phone shows a figure some 370 pixels wide: words of 10 points on 4.8 inches have 11 pixels there.
"""

STYLE = {
    "figure.figsize": (4.8, 3.4),
    "font.size": 10,
    "axes.titlesize": 10,
    "figure.titlesize": 10,
    "figure.titleweight": "bold",
    "legend.frameon": False,
    "text.parse_math": True,
}

CYCLE = ("#332288", "#cc6677", "#44aa99", "#999933", "#882255")
"""Colours of what is no design: designs have theirs in `deepfsi.report.style` (Tol's, muted)."""


def style(gallery_conf, script):
    """Give a script the style, before it and after it."""
    import matplotlib.pyplot as plt
    from cycler import cycler

    from deepfsi.report.style import STYLE as PACKAGE_STYLE

    plt.rcParams.update(PACKAGE_STYLE | STYLE | {"axes.prop_cycle": cycler(color=CYCLE)})
