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

from deepfsi.base.errors import InputError

NEAREST = 0.25
"""Share of the settings, those nearest to the rates, that give correlations and errors."""

LIMIT = float(stats.chi2.ppf(0.95, 1))
"""Deviance up to which a value of one parameter lies in its 95 % interval."""

STARTS, GRID = 6, 25
"""Searches that each maximum is the best of, and values of a profile."""

FARTHEST = 12.0
"""Deviance beyond which a level is not searched for the profiles of other parameters."""

MOST = float(np.log(10))
"""Log of the widest variance over that of alike pictures: where exposures of one picture agree."""

SCATTERED = 2048
"""Settings among which searches start."""


@dataclass(frozen=True)
class Parameter:
    """A setting to be fitted: name, label of its axis, and range; `log` is of its scale.

    One with `levels` has these values and no other.
    """

    name: str
    label: str
    low: float
    high: float
    log: bool = True
    levels: tuple[float, ...] = ()

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
    levels: bool = False  # whether there is nothing between the values


@dataclass(frozen=True)
class Condition:
    """A published rate beside those of the fit: its mean, and what it expects given all others."""

    design: str
    exposure_s: float
    published: float
    fitted: float
    expected: float  # given the others, which are of the same ten pictures
    error: float  # its standard deviation
    pull: float  # (published - expected) / error
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
        shared = scaled.mean(axis=0)
        own = np.maximum(shared.diagonal(), 0.0)  # an estimate without bias may be below 0
        shared -= np.diag(shared.diagonal())
        # The mean itself is of so many pictures of each class
        few = 1 / simulated.drawn
        self._correlation = _positive((1 + few) * shared + np.diag(1 + few * own))
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
        scale = np.exp(np.clip(_quadratic(shares) @ self._scale, -4, MOST))
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
    search = Search(emulator, parameters, stats.qmc.Sobol(len(parameters), rng=rng))
    best, profiles = search.profiles(emulator.rates)
    distance = float(emulator.distances(best[None], emulator.rates)[1][0])
    now = np.clip([float(each.share(before[each.name])) for each in parameters], 0, 1)[None]
    mean, covariance = emulator.means(best[None])[0], emulator.covariance(best[None])[0]
    drawn = rng.multivariate_normal(mean, covariance, tables).clip(0, 1)
    apart = [search.distance(table, best) for table in drawn]
    precision = np.linalg.inv(covariance)
    error = 1 / np.sqrt(precision.diagonal())
    pull = error * (precision @ (emulator.rates - mean))
    return RateFit(
        profiles=profiles,
        conditions=[
            Condition(design, exposure, *map(float, numbers))
            for (design, exposure), *numbers in zip(
                conditions, emulator.rates, mean, emulator.rates - error * pull, error, pull,
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


class Search:
    """Settings that make rates most likely.

    Parameters
    ----------
    emulator : Emulator
    parameters : sequence of Parameter
        One at most has levels.
    sobol : scipy.stats.qmc.Sobol
        Gives settings at which searches start.
    """

    def __init__(
        self, emulator: Emulator, parameters: Sequence[Parameter], sobol: stats.qmc.Sobol
    ) -> None:
        self.emulator, self.parameters = emulator, parameters
        self.scattered = sobol.random(SCATTERED)
        self.axis = next((k for k, each in enumerate(parameters) if each.levels), None)
        stepped = parameters[self.axis or 0]
        self.places = stepped.share(np.array(stepped.levels))

    def least(
        self,
        rates: np.ndarray,
        near: np.ndarray,
        fixed: tuple[int, float] | None = None,
        few: bool = False,
    ) -> np.ndarray:
        """The most likely setting (P,) for rates, `near` (M, P) which there is another search.

        `fixed` is a parameter, by its number, and its share. `few` makes the search shorter.
        """
        candidates = np.vstack([near, self.scattered[: 256 if few else SCATTERED]])
        free = np.ones(len(self.parameters), dtype=bool)
        if fixed is not None:
            candidates[:, fixed[0]] = fixed[1]
            free[fixed[0]] = False
        starts = 2 if few else STARTS

        def loss(at: np.ndarray) -> np.ndarray:
            return self.emulator.distances(at, rates)[0]

        if self.axis is None or not free[self.axis]:
            return minimise(loss, candidates, free, starts)
        free[self.axis] = False
        found = []
        for place in self.places:
            candidates[:, self.axis] = place
            found.append(minimise(loss, candidates.copy(), free, starts))
        return found[int(np.argmin([loss(each[None])[0] for each in found]))]

    def distance(self, rates: np.ndarray, near: np.ndarray) -> float:
        """Squared distance of rates from the setting that makes them most likely."""
        own = self.least(rates, near[None], few=True)
        return float(self.emulator.distances(own[None], rates)[1][0])

    def profiles(self, rates: np.ndarray) -> tuple[np.ndarray, list[Profile]]:
        """The most likely setting, and the profile of each parameter."""
        best = self.least(rates, self.scattered[:1])
        if self.axis is not None:
            at = [self.least(rates, best[None], (self.axis, float(each))) for each in self.places]
            lost = np.array([self._lost(each, best, rates) for each in at])
            self.places = self.places[lost < FARTHEST]  # for all other searches
        while True:
            made = [self._profile(number, best, rates) for number in range(len(self.parameters))]
            lowest = min(
                (point for _, points in made for point in points), key=lambda each: each[1]
            )
            if lowest[1] > -0.01:
                return best, [profile for profile, _ in made]
            best = self.least(rates, lowest[0][None])

    def _lost(self, at: np.ndarray, best: np.ndarray, rates: np.ndarray) -> float:
        both = self.emulator.distances(np.stack([at, best]), rates)[0]
        return float(both[0] - both[1])

    def _profile(
        self, number: int, best: np.ndarray, rates: np.ndarray
    ) -> tuple[Profile, list[tuple[np.ndarray, float]]]:
        """Profile of a parameter, with the setting and the deviance of each of its values."""
        parameter = self.parameters[number]
        places = np.unique(np.append(np.linspace(0, 1, GRID), best[number]))
        if parameter.levels:
            places = parameter.share(np.array(parameter.levels))
        points, at = list[tuple[np.ndarray, float]](), best
        for place in places:
            at = self.least(rates, np.stack([best, at]), (number, float(place)), few=True)
            points.append((at, self._lost(at, best, rates)))
        lost = np.array([deviance for _, deviance in points])
        low, high = _ends(places, lost, best[number], between=not parameter.levels)
        profile = Profile(
            parameter.name,
            parameter.label,
            parameter.log,
            parameter.value(places).tolist(),
            lost.tolist(),
            best=float(parameter.value(best[number])),
            low=float(parameter.value(low)),
            high=float(parameter.value(high)),
            bounded=(bool(low > places[0]), bool(high < places[-1])),
            levels=bool(parameter.levels),
        )
        return profile, points


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
    for place in np.argsort(losses)[: starts if len(moved) else 0]:
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


def _ends(
    places: np.ndarray, deviance: np.ndarray, best: float, between: bool = True
) -> tuple[float, float]:
    """Outermost places at which the deviance crosses `LIMIT`, `between` the places or at one."""
    ends = []
    for below in (True, False):
        side = places <= best if below else places >= best
        x, y = places[side], deviance[side]
        if below:
            x, y = x[::-1], y[::-1]
        inside = np.flatnonzero(y <= LIMIT)
        last = inside[-1] if len(inside) else 0
        if last == len(x) - 1 or not between:
            ends.append(float(x[last]))
        else:
            share = (LIMIT - y[last]) / (y[last + 1] - y[last])
            ends.append(float(x[last] + share * (x[last + 1] - x[last])))
    return ends[0], ends[1]
