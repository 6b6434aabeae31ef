"""One setting of the virtual laboratory fitted to all published rates, by their likelihood.

The rate of a condition (a design and an exposure) is the share of right answers among E exposures
of each of K pictures, one of each class. Let p_k be the chance of a right answer of the picture of
class k. Given the pictures, the rate has variance Σ_k p_k (1 - p_k) / (K² E). The pictures are
drawn, the same for all conditions: their part of the covariance of two conditions is
Σ_k cov_k(p, p') / K², over the pictures of each class. Classes are not drawn, so differences
between them add nothing, and the sum can be narrower than K E independent exposures would be. The
likelihood of all rates is the normal one of these means and this covariance.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize, special, stats

from deepfsi.errors import InputError

NEAREST = 0.25
"""Share of the settings, those nearest to the rates, that give correlations and errors."""

LIMIT = float(stats.chi2.ppf(0.95, 1))
"""Deviance up to which a value of one parameter lies in its 95 % interval."""

STARTS, GRID = 6, 25
"""Searches that each maximum is the best of, and values of a profile."""

SCATTERED = 2048
"""Settings among which searches start."""


@dataclass(frozen=True)
class Parameter:
    """A setting to be fitted: name, label of its axis, and range; `log` is of its scale."""

    name: str
    label: str
    low: float
    high: float
    log: bool = True

    def value(self, share: np.ndarray | float) -> np.ndarray:
        """Values at shares of the range, 0 to 1."""
        share = np.asarray(share, dtype=np.float64)
        if self.log:
            return np.asarray(self.low * (self.high / self.low) ** share)
        return np.asarray(self.low + (self.high - self.low) * share)

    def share(self, value: np.ndarray | float) -> np.ndarray:
        """Shares of the range at which values are."""
        value = np.asarray(value, dtype=np.float64)
        if self.log:
            return np.asarray(np.log(value / self.low) / np.log(self.high / self.low))
        return np.asarray((value - self.low) / (self.high - self.low))


@dataclass(frozen=True)
class Profile:
    """Deviance of one parameter where all others are fitted, and its 95 % interval."""

    name: str
    label: str
    log: bool
    values: Sequence[float]
    deviance: Sequence[float]  # twice the log likelihood that is lost
    best: float
    low: float
    high: float
    bounded: tuple[bool, bool]  # whether each end is found within the range


@dataclass(frozen=True)
class Condition:
    """A published rate beside the fitted one, which has the standard deviation `error`."""

    design: str
    exposure_s: float
    published: float
    fitted: float
    error: float
    pull: float  # (published - fitted) / error
    before: float  # rate of the laboratory as it is


@dataclass(frozen=True)
class RateFit:
    """Fit of published rates.

    Attributes
    ----------
    profiles : sequence of Profile
    conditions : sequence of Condition
    deviance : float
        Squared distance of the rates from the fit, by their covariance.
    freedom : int
        Rates less parameters.
    p : float
        Share of tables drawn from the fit, and fitted themselves, that lie as far from their fit.
    before : float
        Squared distance of the rates from the laboratory as it is.
    settings, tables : int
        Simulated settings, and tables drawn from the fit.
    """

    profiles: Sequence[Profile]
    conditions: Sequence[Condition]
    deviance: float
    freedom: int
    p: float
    before: float
    settings: int
    tables: int


@dataclass(frozen=True)
class SimulatedRates:
    """Rates of conditions at settings, and their moments.

    Attributes
    ----------
    means : array, shape (T, C)
    exposure : array, shape (T, C)
        Variance of a rate of one exposure of each picture, given the pictures.
    pictures : array, shape (T, C, C)
        Covariance of rates by the draw of the pictures.
    drawn : float
        Pictures of each class behind a mean.
    exposures : float
        Simulated exposures of each picture.
    """

    means: np.ndarray
    exposure: np.ndarray
    pictures: np.ndarray
    drawn: int
    exposures: int


def moments(right: np.ndarray, exposures: int) -> SimulatedRates:
    """Means and covariances of rates, without bias by the number of simulated exposures.

    Parameters
    ----------
    right : array, shape (T, C, J, K)
        Right answers of `exposures` to each of J pictures of each of K classes, at T settings in
        C conditions.
    exposures : int
        Two or more.
    """
    conditions, pictures, classes = right.shape[1:]
    share = right / exposures
    within = share * (1 - share) * exposures / (exposures - 1)
    exposure = within.mean(axis=2).sum(axis=-1) / classes**2
    off = share - share.mean(axis=2, keepdims=True)
    covariance = np.einsum("tcjk,tdjk->tcd", off, off) / ((pictures - 1) * classes**2)
    places = np.arange(conditions)
    covariance[:, places, places] -= exposure / exposures
    return SimulatedRates(share.mean(axis=(2, 3)), exposure, covariance, pictures, exposures)


class Emulator:
    """Smooth functions of the parameters through simulated rates, and their covariance.

    Parameters
    ----------
    shares : array, shape (T, P)
        Settings, as shares of the ranges.
    simulated : SimulatedRates
    rates : array, shape (C,)
        Published.
    exposures : array, shape (C,)
        Published exposures of each picture.
    """

    def __init__(
        self,
        shares: np.ndarray,
        simulated: SimulatedRates,
        rates: np.ndarray,
        exposures: np.ndarray,
    ) -> None:
        self.shares, self.rates = shares, np.asarray(rates, dtype=np.float64)
        picture = simulated.pictures.diagonal(axis1=1, axis2=2)
        total = np.maximum(picture + simulated.exposure / exposures, 1e-6)
        known = simulated.means
        logits = special.logit((known * 999 + 0.5) / 1000)
        self._offset = logits.mean(axis=0)
        self._inverse_square, self._weights, left_out = _smooth(shares, logits - self._offset)
        predicted = special.expit(left_out + self._offset)
        distance = np.square((known - self.rates) / np.sqrt(total)).sum(axis=1)
        near = np.argsort(distance)[: max(20, round(NEAREST * len(shares)))]
        classes_share = _binomial(known)
        self._scale = np.linalg.lstsq(
            _quadratic(shares), np.log(total / classes_share), rcond=None
        )[0]
        sd = np.sqrt(total[near])
        scaled = simulated.pictures[near] / (sd[:, :, None] * sd[:, None, :])
        self._correlation = scaled.mean(axis=0) * (1 + 1 / simulated.drawn)
        np.fill_diagonal(
            self._correlation, 1 + (1 / simulated.drawn) * scaled.mean(axis=0).diagonal()
        )
        errors = (known - predicted)[near]
        noise = simulated.exposure[near].mean(axis=0) / (simulated.drawn * simulated.exposures)
        self.scatter = _positive(errors.T @ errors / len(near) - np.diag(noise))

    def means(self, shares: np.ndarray) -> np.ndarray:
        """Rates (M, C) at settings (M, P)."""
        apart = np.square(shares[:, None] - self.shares)
        kernel = np.exp(-0.5 * np.einsum("mtp,cp->cmt", apart, self._inverse_square))
        return np.asarray(
            special.expit(np.einsum("cmt,tc->mc", kernel, self._weights) + self._offset)
        )

    def covariance(self, shares: np.ndarray) -> np.ndarray:
        """Covariance (M, C, C) of rates at settings (M, P), with that of training and emulator."""
        scale = np.exp(np.clip(_quadratic(shares) @ self._scale, -4, 3))
        sd = np.sqrt(scale * _binomial(self.means(shares)))
        return np.asarray(sd[:, :, None] * self._correlation * sd[:, None, :] + self.scatter)

    def distances(self, shares: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Minus twice the log likelihood (M,) of rates, and their squared distance (M,)."""
        covariance = self.covariance(shares)
        off = rates - self.means(shares)
        distance = np.einsum("mc,mc->m", off, np.linalg.solve(covariance, off[..., None])[..., 0])
        return np.linalg.slogdet(covariance)[1] + distance, distance


def _binomial(rates: np.ndarray) -> np.ndarray:
    """Variance of a rate of one exposure of ten alike pictures."""
    return np.maximum(rates * (1 - rates), 0.002) / 100


def _quadratic(shares: np.ndarray) -> np.ndarray:
    """Terms (M, 1 + P + P (P + 1) / 2) of a quadratic function of settings (M, P)."""
    centred = 2 * np.asarray(shares) - 1
    first, second = np.triu_indices(centred.shape[1])
    return np.hstack([np.ones((len(centred), 1)), centred, centred[:, first] * centred[:, second]])


def _positive(matrix: np.ndarray) -> np.ndarray:
    """The nearest symmetric matrix without negative eigenvalues."""
    values, vectors = linalg.eigh((matrix + matrix.T) / 2)
    return np.asarray((vectors * np.maximum(values, 1e-8)) @ vectors.T)


def _smooth(shares: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gaussian processes through values (T, C): 1/l² (C, P), weights and each left out (T, C)."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    inverse, weights, left_out = [], [], []
    for column in values.T:
        kernel = ConstantKernel(column.var() + 1e-3, (1e-4, 1e2)) * RBF(
            np.ones(shares.shape[1]), (0.1, 30.0)
        ) + WhiteKernel(1e-2, (1e-5, 1.0))
        with warnings.catch_warnings():
            # A length or a strength at its bound: no rate depends on the parameter, or all alike
            warnings.simplefilter("ignore", ConvergenceWarning)
            made = GaussianProcessRegressor(kernel, alpha=1e-8).fit(shares, column)
        smooth = made.kernel_.k1
        precision = linalg.cho_solve((made.L_, True), np.eye(len(shares)))
        inverse.append(1 / np.square(np.broadcast_to(smooth.k2.length_scale, shares.shape[1])))
        weights.append(made.alpha_ * smooth.k1.constant_value)
        left_out.append(column - made.alpha_ / precision.diagonal())
    return np.array(inverse), np.array(weights).T, np.array(left_out).T


def fit_rates(
    emulator: Emulator,
    parameters: Sequence[Parameter],
    conditions: Sequence[tuple[str, float]],
    before: Mapping[str, float],
    tables: int = 200,
    seed: int = 0,
) -> RateFit:
    """Fit the parameters to an emulator's rates.

    Parameters
    ----------
    emulator : Emulator
    parameters : sequence of Parameter
    conditions : sequence of (str, float)
        Design and exposure of each rate.
    before : mapping of str to float
        Values of the laboratory as it is.
    tables : int
        Drawn from the fit, for p.
    seed : int
    """
    if len(parameters) != emulator.shares.shape[1]:
        raise InputError(
            f"{len(parameters)} parameters for settings of {emulator.shares.shape[1]}: give as many"
        )
    rng = np.random.default_rng(seed)
    scattered = stats.qmc.Sobol(len(parameters), rng=rng).random(SCATTERED)
    best = minimise(lambda at: emulator.distances(at, emulator.rates)[0], scattered)
    least, distance = (float(each[0]) for each in emulator.distances(best[None], emulator.rates))
    profiles = [
        _profile(emulator, number, each, best, least, scattered)
        for number, each in enumerate(parameters)
    ]
    now = np.clip([float(each.share(before[each.name])) for each in parameters], 0, 1)[None]
    mean, covariance = emulator.means(best[None])[0], emulator.covariance(best[None])[0]
    drawn = rng.multivariate_normal(mean, covariance, tables).clip(0, 1)
    near = np.vstack([best, scattered[:256]])
    apart = [_least_distance(emulator, table, near) for table in drawn]
    error = np.sqrt(covariance.diagonal())
    return RateFit(
        profiles=profiles,
        conditions=[
            Condition(design, exposure, *map(float, numbers))
            for (design, exposure), *numbers in zip(
                conditions, emulator.rates, mean, error, (emulator.rates - mean) / error,
                emulator.means(now)[0], strict=True,
            )
        ],
        deviance=distance,
        freedom=len(conditions) - len(parameters),
        p=float((1 + np.sum(np.array(apart) >= distance)) / (1 + tables)),
        before=float(emulator.distances(now, emulator.rates)[1][0]),
        settings=len(emulator.shares),
        tables=tables,
    )  # fmt: skip


def _least_distance(emulator: Emulator, table: np.ndarray, candidates: np.ndarray) -> float:
    """Squared distance of a table of rates from its own fit."""
    own = minimise(lambda at: emulator.distances(at, table)[0], candidates, starts=2)
    return float(emulator.distances(own[None], table)[1][0])


def minimise(
    loss: Callable[[np.ndarray], np.ndarray],
    candidates: np.ndarray,
    free: np.ndarray | None = None,
    starts: int = STARTS,
) -> np.ndarray:
    """Least loss (M, P) → (M,) in the unit cube, from the best candidates (M, P).

    Coordinates that are not `free` (P,) keep the candidates' values.
    """
    count = candidates.shape[1]
    moved = np.flatnonzero(np.ones(count, bool) if free is None else free)
    step = 1e-4
    losses = np.concatenate(
        [loss(candidates[first : first + 128]) for first in range(0, len(candidates), 128)]
    )
    found, least = candidates[losses.argmin()], losses.min()
    for place in np.argsort(losses)[:starts]:
        start = candidates[place]

        def both(x: np.ndarray, start: np.ndarray = start) -> tuple[float, np.ndarray]:
            at = np.repeat(start[None], 1 + 2 * len(moved), axis=0)
            at[:, moved] = x
            for number, axis in enumerate(moved):
                at[1 + 2 * number, axis] += step
                at[2 + 2 * number, axis] -= step
            values = loss(at)
            return float(values[0]), (values[1::2] - values[2::2]) / (2 * step)

        made = optimize.minimize(
            both, start[moved], jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * len(moved)
        )
        if made.fun < least:
            found, least = start.copy(), made.fun
            found[moved] = made.x
    return np.asarray(found)


def _profile(
    emulator: Emulator,
    number: int,
    parameter: Parameter,
    best: np.ndarray,
    least: float,
    scattered: np.ndarray,
) -> Profile:
    free = np.arange(len(best)) != number
    places = np.unique(np.append(np.linspace(0, 1, GRID), best[number]))
    deviance, start = [], best
    for place in places:
        candidates = np.vstack([best, start, scattered[:256]])
        candidates[:, number] = place
        start = minimise(
            lambda at: emulator.distances(at, emulator.rates)[0], candidates, free, starts=3
        )
        deviance.append(float(emulator.distances(start[None], emulator.rates)[0][0]) - least)
    lost = np.array(deviance)
    low, high = _ends(places, lost, best[number])
    return Profile(
        parameter.name,
        parameter.label,
        parameter.log,
        parameter.value(places).tolist(),
        lost.tolist(),
        best=float(parameter.value(best[number])),
        low=float(parameter.value(low)),
        high=float(parameter.value(high)),
        bounded=(low > 0, high < 1),
    )


def _ends(places: np.ndarray, deviance: np.ndarray, best: float) -> tuple[float, float]:
    """Outermost places at which the deviance crosses `LIMIT`; 0 or 1 where it does not."""
    ends = []
    for side, outermost in ((places <= best, 0.0), (places >= best, 1.0)):
        x, y = places[side], deviance[side]
        if outermost == 0.0:
            x, y = x[::-1], y[::-1]
        inside = np.flatnonzero(y <= LIMIT)
        last = inside[-1] if len(inside) else 0
        if last == len(x) - 1:
            ends.append(outermost)
        else:
            share = (LIMIT - y[last]) / (y[last + 1] - y[last])
            ends.append(float(x[last] + share * (x[last + 1] - x[last])))
    return ends[0], ends[1]
