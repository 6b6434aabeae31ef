"""Confidence intervals of one accuracy."""


def wilson(accuracy: float, images: int) -> tuple[float, float]:
    """95 % interval of a mean over images, each of which counts as one trial."""
    from scipy.stats import binomtest

    found = binomtest(round(accuracy * images), images).proportion_ci(0.95, method="wilson")
    return float(found.low), float(found.high)
