"""Area under the receiver operating characteristic, with an interval over images and seeds."""

import math

import numpy as np

from deepfsi.statistics.intervals import Interval, Z, over_seeds


def auc_terms(scores: np.ndarray, positive: np.ndarray) -> np.ndarray:
    """Terms (n,) of images whose mean is the area under the ROC curve, and varies as it does.

    The area is the probability that a positive image scores higher than another one, ties half.

    Parameters
    ----------
    scores : array, shape (n, d)
        Of d exposures of each image.
    positive : array, shape (n,), bool
        Which images are positive; some are, and some are not.

    Notes
    -----
    The variance over n of the terms is that of E. R. DeLong, D. M. DeLong and D. L. Clarke-Pearson
    (Biometrics 44, 837, 1988), with the mean of an image's exposures as one observation.
    """
    from scipy.stats import rankdata

    ranks = rankdata(scores).reshape(scores.shape)
    above = np.empty(len(scores))
    for kind, rows in ((True, positive), (False, ~positive)):
        own = rankdata(scores[rows]).reshape(-1, scores.shape[1])
        share = (ranks[rows] - own) / (scores.size - own.size)  # of the other kind that are lower
        above[rows] = (share if kind else 1 - share).mean(axis=1)
    area = float(above[positive].mean())
    terms = np.empty(len(scores))
    for rows in (positive, ~positive):
        count = int(rows.sum())
        weight = len(scores) / math.sqrt(count * max(count - 1, 1))
        terms[rows] = area + weight * (above[rows] - above[rows].mean())
    return terms


def auc(terms: np.ndarray, positive: np.ndarray) -> Interval:
    """Area under the ROC curve with its 95 % interval, of terms (S, n) or (n,) of `auc_terms`.

    Over images the interval is symmetric in log(A / (1 − A)). Of an area of 1 or 0 it ends where
    three images in a hundred of the rarer kind would be, at 3 / n (the rule of three).
    """
    rows = np.atleast_2d(terms)
    each = rows.mean(axis=0)
    area = float(np.clip(each.mean(), 0.0, 1.0))
    error = float(each.std()) / math.sqrt(len(each))
    if min(area, 1 - area) < 1e-12:
        area = float(round(area))
        reach = min(3 / min(int(positive.sum()), int((~positive).sum())), 1.0)
        low, high = area - reach, area + reach
    else:
        middle, half = math.log(area / (1 - area)), Z * error / (area * (1 - area))
        low, high = (1 / (1 + math.exp(-(middle + off))) for off in (-half, half))
    return over_seeds(Interval(area, low, high), rows, (0.0, 1.0))
