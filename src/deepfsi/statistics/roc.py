"""Area under the receiver operating characteristic, with an interval over images."""

import math

import numpy as np

from deepfsi.statistics.intervals import Z


def auc(scores: np.ndarray, positive: np.ndarray) -> tuple[float, float, float]:
    """Area under the ROC curve with its 95 % interval, low and high.

    It is the probability that a positive image scores higher than another one, ties half.

    Parameters
    ----------
    scores : array, shape (n, d)
        Of d exposures of each image.
    positive : array, shape (n,), bool
        Which images are positive; some are, and some are not.

    Notes
    -----
    The variance is that of E. R. DeLong, D. M. DeLong and D. L. Clarke-Pearson (Biometrics 44, 837,
    1988), with the mean of an image's exposures as one observation; the interval is symmetric in
    log(A / (1 − A)). Of an area of 1 or 0 it ends where three images in a hundred of the rarer kind
    would be, at 3 / n (the rule of three).
    """
    from scipy.stats import rankdata

    ranks = rankdata(scores).reshape(scores.shape)
    above, places = {}, {True: positive, False: ~positive}
    for kind, rows in places.items():
        own = rankdata(scores[rows]).reshape(-1, scores.shape[1])
        share = (ranks[rows] - own) / (scores.size - own.size)  # of the other kind that are lower
        above[kind] = (share if kind else 1 - share).mean(axis=1)
    area = float(above[True].mean())
    if area in (0.0, 1.0):
        reach = min(3 / min(map(len, above.values())), 1.0)
        return area, max(area - reach, 0.0), min(area + reach, 1.0)
    spread = sum(float(each.var(ddof=min(len(each) - 1, 1))) / len(each) for each in above.values())
    middle, half = math.log(area / (1 - area)), Z * math.sqrt(spread) / (area * (1 - area))
    low, high = (1 / (1 + math.exp(-(middle + off))) for off in (-half, half))
    return area, low, high
