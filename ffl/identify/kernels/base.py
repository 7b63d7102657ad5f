"""What a kernel is: a covariance D(k, k') of the impulse response on the lags k, with gradients.

A kernel is a frozen object that says its covariance (`matrix`), a low-rank factor of it, and the
gradient of any scalar function of D by its own hyperparameters, which it states in unconstrained
coordinates (logarithms and the like), so that an optimiser needs no bounds to stay legal.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from ffl.errors import InputError

Array = NDArray[np.float64]

RANK_TOLERANCE = 1e-14
ROUNDING = 1e-12  # of a lag's variance


@dataclass(frozen=True)
class Factor:
    """D = columns columns^T on the lags; a column with `flat` True has infinite prior variance.

    `dropped`: variance of every lag that the columns leave out, where their number is cut.
    """

    columns: Array
    flat: NDArray[np.bool_]
    dropped: Array


class Slope(Protocol):
    """Derivative S = dL/dD of a scalar L at the kernel's own covariance."""

    def dense(self) -> Array:
        """S, shape (n, n)."""

    def own(self) -> Array:
        """S B for the kernel's own factor columns B, shape (n, p): all a factored kernel needs."""


class Kernel(ABC):
    """Covariance of theta_k on integer lags k (negative: anti-causal)."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Names of the hyperparameters that are learned, in the order of `coordinates`."""

    @property
    @abstractmethod
    def coordinates(self) -> Array:
        """Unconstrained coordinates of the learned hyperparameters."""

    @property
    @abstractmethod
    def bounds(self) -> list[tuple[float, float]]:
        """Range of every coordinate in which the kernel is numerically sound."""

    @property
    def spread(self) -> Array:
        """Standard deviation of a Gaussian hyperprior on each coordinate around its present value;
        infinite where nothing is expected.
        """
        return np.full(len(self.names), np.inf)

    @property
    def starts(self) -> list[Array]:
        """Coordinates from which a search may start: the present ones, and others worth a look."""
        return [self.coordinates]

    @abstractmethod
    def at(self, coordinates: Array) -> Self:
        """The same kernel with its learned hyperparameters moved there."""

    @abstractmethod
    def matrix(self, lags: Array) -> Array:
        """D on the lags, shape (n, n)."""

    @abstractmethod
    def gradient(self, lags: Array, slope: Slope) -> Array:
        """dL/dcoordinates for a scalar L with dL/dD = slope."""

    def tangents(self, lags: Array, coefficients: Array) -> Array:
        """Derivative of theta = B c by every coordinate, c held, shape (n, n_coordinates).

        Zero for hyperparameters that only weigh; not for those that move functions, as poles do.
        Their uncertainty is part of the posterior's, and tells how the evidence is curved.
        """
        return np.zeros((len(lags), len(self.names)))

    def factor(self, lags: Array) -> Factor:
        """Low-rank factor by pivoted Cholesky, to 1e-14 of the largest variance. O(n p^2)."""
        matrix = self.matrix(lags)
        columns, flat = pivoted_factor(matrix)
        variance = np.diag(matrix)
        left = variance - np.sum(columns**2, axis=1)
        return Factor(columns, flat, np.where(left > ROUNDING * variance, left, 0.0))

    def __add__(self, other: Kernel) -> Kernel:
        from ffl.identify.kernels.algebra import Sum

        return Sum((self, other))

    def __mul__(self, other: Kernel) -> Kernel:
        from ffl.identify.kernels.algebra import Product

        return Product(self, other)


def pivoted_factor(matrix: Array) -> tuple[Array, NDArray[np.bool_]]:
    """B with B B^T = matrix and as many columns as the numerical rank."""
    n = len(matrix)
    largest = float(np.diag(matrix).max(initial=0.0))
    if largest <= 0.0:
        return np.zeros((n, 0)), np.zeros(0, bool)
    low, pivots, rank, info = lapack.dpstrf(matrix, lower=1, tol=RANK_TOLERANCE * largest)
    if info < 0:
        raise InputError("kernel: the covariance holds NaN; check its hyperparameters")
    columns = np.zeros((n, rank))
    columns[pivots - 1] = np.tril(low)[:, :rank]
    return columns, np.zeros(rank, bool)


# scales of 1e-43 to 1e43; memories of 1e6 samples down to a twentieth; correlations short of +-1
SCALE_BOUNDS = (-100.0, 100.0)
DECAY_BOUNDS = (float(np.log(1e-6)), float(np.log(20.0)))
BOUNDS = {"scale": SCALE_BOUNDS, "correlation": (-10.0, 10.0)}

SIDES = ("both", "causal", "anticausal")


@dataclass(frozen=True)
class Decaying(Kernel):
    """A kernel with an exponential envelope b(k) around a peak.

        b(k) = decay_causal^(k - peak)        for k >= peak
        b(k) = decay_anticausal^(peak - k)    for k <  peak

    `side` "causal" keeps k >= peak, "anticausal" k <= peak, "both" everything; outside, D = 0.
    Source: 2025 Bayesian paper, equation (10), with the peak made free; how taps on different sides
    correlate is the kernel's affair. Hyperparameters in `fixed` are not learned.
    """

    scale: float = 1.0
    decay_causal: float = 0.9
    decay_anticausal: float = 0.9
    peak: int = 0
    side: str = "both"
    fixed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.side not in SIDES:
            raise InputError(f"kernel side {self.side!r} is none of {SIDES}")
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise InputError(f"kernel scale = {self.scale} must be positive and finite")
        for name in ("decay_causal", "decay_anticausal"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise InputError(f"kernel {name} = {getattr(self, name)} must lie in (0, 1)")
        unknown = set(self.fixed) - set(self._hyperparameters())
        if unknown:
            raise InputError(f"kernel: fixed names {sorted(unknown)} are no hyperparameters")

    def _hyperparameters(self) -> tuple[str, ...]:
        sides = {"both": ("decay_causal", "decay_anticausal")}
        return ("scale", *sides.get(self.side, (f"decay_{self.side}",)))

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for name in self._hyperparameters() if name not in self.fixed)

    @property
    def coordinates(self) -> Array:
        return np.array([_to_coordinate(name, getattr(self, name)) for name in self.names])

    @property
    def bounds(self) -> list[tuple[float, float]]:
        return [BOUNDS.get(name, DECAY_BOUNDS) for name in self.names]

    @property
    def starts(self) -> list[Array]:
        """The present decays, then short to long memory, equal on both sides."""
        starts = [self.coordinates]
        for decay in (0.5, 0.8, 0.95, 0.99):
            start = self.coordinates.copy()
            for i, name in enumerate(self.names):
                if name.startswith("decay"):
                    start[i] = _to_coordinate(name, decay)
            starts.append(start)
        return starts

    def at(self, coordinates: Array) -> Self:
        moved: dict[str, Any] = {
            name: _from_coordinate(name, float(value))
            for name, value in zip(self.names, coordinates, strict=True)
        }
        return replace(self, **moved)

    def _envelope(self, lags: Array) -> tuple[Array, dict[str, Array]]:
        """b(k), zero off the kernel's side, and db/dcoordinate by the name of each decay."""
        ahead = np.asarray(lags, float) - self.peak
        causal, anticausal = ahead >= 0, ahead < 0
        if self.side == "anticausal":
            causal, anticausal = np.zeros_like(causal), ahead <= 0
        elif self.side == "causal":
            anticausal = np.zeros_like(causal)
        b = np.zeros(len(ahead))
        slopes = {}
        for name, part in (("decay_causal", causal), ("decay_anticausal", anticausal)):
            log_decay = np.log(getattr(self, name))
            b[part] = np.exp(log_decay * np.abs(ahead[part]))
            # the coordinate is log(-log decay), whose derivative of log decay is log decay itself
            slopes[name] = np.where(part, log_decay * np.abs(ahead) * b, 0.0)
        return b, slopes

    def _same_side(self, lags: Array) -> NDArray[np.bool_]:
        """True where k and k' lie on one side of the peak, which belongs to both sides."""
        ahead = np.asarray(lags, float) - self.peak
        return np.multiply.outer(np.sign(ahead), np.sign(ahead)) >= 0

    @abstractmethod
    def _slopes(self, lags: Array) -> dict[str, Array]:
        """dD/dcoordinate of each hyperparameter but the scale, by name."""

    def gradient(self, lags: Array, slope: Slope) -> Array:
        dense = slope.dense()
        slopes = {"scale": self.matrix(lags), **self._slopes(lags)}
        return np.array([np.vdot(dense, slopes[name]) for name in self.names])


def _to_coordinate(name: str, value: float) -> float:
    if name == "scale":
        return float(np.log(value))
    if name == "correlation":
        return float(np.arctanh(value))
    return float(np.log(-np.log(value)))


def _from_coordinate(name: str, value: float) -> float:
    if name == "scale":
        return float(np.exp(value))
    if name == "correlation":
        return float(np.tanh(value))
    return float(np.exp(-np.exp(value)))
