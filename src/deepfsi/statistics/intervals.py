"""Confidence intervals of an accuracy, over images or trials, and of the mean of the classes'."""

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np

Z = NormalDist().inv_cdf(0.975)


def wilson(accuracy: float, images: int) -> tuple[float, float]:
    """95 % interval of a mean over images, each of which counts as one trial."""
    # in closed form: scipy's binomtest, which gives it too, tests a hypothesis first
    rate, part = round(accuracy * images) / images, Z**2 / images
    half = math.sqrt(part * (rate * (1 - rate) + part / 4))
    low, high = ((rate + part / 2 + off) / (1 + part) for off in (-half, half))
    return low if rate > 0 else 0.0, high if rate < 1 else 1.0


def student(values: Sequence[float]) -> tuple[float, float]:
    """95 % interval of a mean over trials."""
    from scipy import stats

    mean = float(np.mean(values))
    half = float(stats.t.ppf(0.975, len(values) - 1)) * float(stats.sem(values))
    return mean - half, mean + half


def balanced(rates: Sequence[float | None], images: Sequence[int]) -> tuple[float, float, float]:
    """Mean of the classes' accuracies with its 95 % interval, low and high."""
    # Every class counts alike, whatever its number of images; classes without any are left out. The
    # interval combines Wilson's of the classes (the method of variance estimates recovery): the
    # squared distances of their lower ends from their rates add up to that of the mean's lower end
    # times the number of classes, and those of the upper ends likewise. So a class of one image,
    # right or wrong, still has its say in the width. It covers the truth in 95 of 100 tests of 40
    # images a class, and in 90 to 97 where classes have one to three
    known = [(rate, count) for rate, count in zip(rates, images, strict=True) if rate is not None]
    mean = sum(rate for rate, _ in known) / len(known)
    ends = [(rate, *wilson(rate, count)) for rate, count in known]
    below = math.hypot(*(rate - low for rate, low, _ in ends)) / len(known)
    above = math.hypot(*(high - rate for rate, _, high in ends)) / len(known)
    return mean, max(mean - below, 0.0), min(mean + above, 1.0)


def worst_of(rates: Sequence[float | None]) -> int:
    """Place of the class with the lowest accuracy, of those that have one."""
    return min((rate, place) for place, rate in enumerate(rates) if rate is not None)[1]
