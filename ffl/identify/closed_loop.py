"""Inverse of a plant from one closed-loop trial: instrumental variables against feedback's bias.

In closed loop u = f + C (r - y) and y = P (u + w) + v, so the output that serves as regressor holds
the sensor noise v, and so does u through C: least squares on u = F y is biased however long the
record is. The reference is known and free of noise: what the loop would answer to it without noise
is correlated with y and not with v, which makes it an instrument.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from ffl.bases.base import Basis
from ffl.errors import InputError
from ffl.identify.estimator import Estimator, force
from ffl.identify.inverse import Band, InverseBasis, magnitude_band
from ffl.identify.regression import upper_triangle
from ffl.systems import Plant, StateSpace
from ffl.systems.checked import checked

Array = NDArray[np.float64]

RANK_TOLERANCE = 1e-10
FIRST = 10  # samples by which it is seen whether a recording begins at rest
MOVES = 5.0  # times what y shakes by: so much drift in these is motion
ROUNDING = 1e-6  # of its range: so little drift is none
LONGEST = 300  # samples at the beginning that are left out
LOOKS_BACK = 1e-6  # of its largest answer: what a function still says of a sample long past


@dataclass(frozen=True)
class ParametricInverse:
    """F = sum_k theta_k psi_k with functions of a `Basis`; `spread` S, covariance S S^T of theta."""

    functions: Basis
    theta: Array
    spread: Array
    sample_time: float

    @property
    def n_ac(self) -> int:
        """Samples of preview of the basis, -1 where it looks ahead without end."""
        return self.functions.preview

    @property
    def standard_errors(self) -> Array:
        return np.sqrt(np.sum(self.spread**2, axis=1))

    def feedforward(self, reference: ArrayLike) -> Array:
        """F r on the samples of the reference, which rests before and after."""
        return self.functions.regressors(checked(reference, "reference")) @ self.theta

    def basis(self, name: str = "identified inverse") -> InverseBasis:
        """The inverse as a basis of one function, for the trial loop."""
        return InverseBasis(self, name)

    def response(self, frequencies_hz: ArrayLike) -> NDArray[np.complex128]:
        """F(exp(i 2 pi f T))."""
        return self._functions_at(frequencies_hz) @ self.theta

    def magnitude_band(self, frequencies_hz: ArrayLike, level: float = 0.95) -> Band:
        """Confidence band of |F|, linearised."""
        return magnitude_band(self._functions_at(frequencies_hz), self.theta, self.spread, level)

    def plot(self, ax: Any, frequencies_hz: ArrayLike, level: float = 0.95) -> Any:
        """Draws |F| with its confidence band over `frequencies_hz` on matplotlib axes `ax`."""
        f = np.asarray(frequencies_hz, float)
        band = self.magnitude_band(f, level)
        name = f"{100 * level:g} % band"
        ax.fill_between(f, band.lower, band.upper, color="C0", alpha=0.25, linewidth=0, label=name)
        ax.loglog(f, band.middle, color="C0", label="estimate")
        ax.set_xlabel("frequency [Hz]")
        ax.set_ylabel("|F| [command per output]")
        ax.legend()
        return ax

    def _functions_at(self, frequencies_hz: ArrayLike) -> NDArray[np.complex128]:
        psi = self.functions.response(frequencies_hz)
        if psi is None:
            raise InputError("the basis is not time-invariant, so F has no frequency response")
        return psi


class InstrumentalInverse(Estimator):
    """theta of u + d = F(theta) y from a closed-loop recording, by instrumental variables.

        theta = argmin || Q^T L (u + d - Psi(q) y theta) ||,   Q R = L Psi(q) y_model

    d is the recording's known load (none: zero). `model` is the plant with its controller, as it is
    believed to be: it simulates the noise-free answer y_model to r, f and d (the instrument), and its
    process sensitivity L = SP weighs the equation error as tracking error. A wrong model costs
    variance, not bias. `basis` parametrizes F; `method` "least_squares" leaves the instruments out,
    to see what the feedback's bias is.

    Learns `inverse_`, `theta_`, `residual_` (output units), `rank_` (directions of theta that the
    trial sees; the rest is zero) and `instrument_strength_`: the smallest canonical correlation of
    instruments and regressors (near 0: noise carries that direction, not the reference). The
    standard errors count what the basis cannot describe as noise, so they are on the large side.

    Source: 2018 kernel paper, Remark 1 and section 2.2; two-stage least squares (Söderström and
    Stoica, 1989, chapter 8). Cost O(N p^2) for p functions.
    """

    def __init__(self, basis: Basis, model: Plant, method: str = "instrumental") -> None:
        self.basis = basis
        self.model = model
        self.method = method

    def fit(self, recording: Any, target: None = None) -> Self:
        """Learns from one recording with r, f, u and y.

        Where it begins in motion the model's state is estimated, and the first samples, whose u answers
        what y did before, are left out.
        """
        if target is not None:
            raise InputError("InstrumentalInverse.fit takes one recording with r, f, u and y")
        if self.method not in ("instrumental", "least_squares"):
            raise InputError(
                f'method = {self.method!r} is neither "instrumental" nor "least_squares"'
            )
        r, f, y = (checked(getattr(recording, name), name) for name in ("r", "f", "y"))
        total, load = checked(force(recording), "u"), getattr(recording, "d", None)
        if self.model.controller is None:
            raise InputError(
                f"{self.model.name} has no [controller]; give the one the trial ran with"
            )
        p = self.basis.n_parameters
        if len(y) <= p:
            raise InputError(f"{len(y)} samples are fewer than the {p} functions; record longer")
        if not np.ptp(y) > 0:
            raise InputError("output is constant: it excites nothing; record a machine that moves")
        loop = self.model.require_stable()
        weight = loop.process_sensitivity
        at_rest = _at_rest(y)
        regressors = _filtered(weight, self.basis.regressors(y))
        scale = np.linalg.norm(regressors, axis=0)
        if not np.all(scale > 0):
            raise InputError("the output does not excite every function of the basis; remove these")
        instruments = regressors
        if self.method == "instrumental":
            known = f if load is None else f + load
            answer = loop.system.select([0], [0, 1]).filter(np.column_stack([r, known]))
            if not at_rest:  # the state that it begins in, a few numbers from y
                own = loop.system.free_response(len(y))
                answer = answer + own @ scipy.linalg.lstsq(own, y - answer)[0]
            instruments = _filtered(weight, self.basis.regressors(answer))
        a, b = regressors / scale, weight.filter(total)
        strength = np.linalg.norm(instruments, axis=0)
        if not np.all(strength > 0):
            raise InputError(
                "reference and feedforward excite nothing that could serve as instrument; record a "
                "trial with a motion"
            )
        unsaid = np.zeros((len(y), 0)) if at_rest else _beginning(self.basis, weight, len(y))
        a, b = _beyond(unsaid, a), _beyond(unsaid, b)
        instruments = _beyond(unsaid, instruments)
        q = scipy.linalg.orth(instruments / strength, RANK_TOLERANCE)
        left, singular, right = np.linalg.svd(q.T @ a, full_matrices=False)
        seen = singular > RANK_TOLERANCE * singular[0]
        self.rank_ = int(np.sum(seen))
        inverse = np.where(seen, 1.0 / np.where(seen, singular, 1.0), 0.0)
        solver = right.T @ (left * inverse).T / scale[:, None]
        self.theta_ = solver @ (q.T @ b)
        self.residual_ = b - a @ (scale * self.theta_)
        spread = solver @ _long_run_root(q * self.residual_[:, None])
        self.inverse_ = ParametricInverse(self.basis, self.theta_, spread, self.model.sample_time)
        own = scipy.linalg.orth(a, RANK_TOLERANCE)
        self.instrument_strength_ = float(np.linalg.svd(q.T @ own, compute_uv=False)[-1])
        return self

    def predict(self, reference: ArrayLike) -> Array:
        """Feedforward for a reference."""
        return self._learned("inverse_").feedforward(reference)


def _at_rest(y: Array) -> bool:
    """Whether `y` begins at rest: it moves no more in its first samples than it shakes there."""
    first = y[:FIRST]
    t = np.arange(len(first), dtype=float)
    drift, level = np.polyfit(t, first, 1)
    shakes = float(np.std(first - level - drift * t))
    return abs(drift) * len(first) <= max(MOVES * shakes, ROUNDING * float(np.ptp(y)))


def _beginning(basis: Basis, weight: StateSpace, n: int) -> Array:
    """What an equation that fails in the first samples, as far as the functions look back, makes of all n:
    orthonormal columns."""
    pulse = np.zeros(2 * (n // 2) + 1)
    pulse[n // 2] = 1.0
    answer = np.max(np.abs(basis.regressors(pulse)), axis=1)
    late = np.flatnonzero(answer[n // 2 :] > LOOKS_BACK * answer.max())
    reach = int(min(late[-1] if late.size else 0, n // 10, LONGEST)) + 1
    columns = _filtered(weight, np.eye(n, reach))
    return scipy.linalg.orth(columns)


def _beyond(columns: Array, x: Array) -> Array:
    """`x` beyond what orthonormal `columns` say of it."""
    return x - columns @ (columns.T @ x)


def _filtered(system: StateSpace, columns: Array) -> Array:
    return np.column_stack([system.filter(column) for column in columns.T])


def _long_run_root(moments: Array) -> Array:
    """Root of the covariance of the summed moments, allowing for their colour (Newey and West).

    Bartlett weights over N^(1/3) lags; sums over lags as a moving average, so that what comes out is
    a sum of squares: no negative variance.
    """
    n = len(moments)
    window = max(1, round(n ** (1.0 / 3.0)))
    sums = np.cumsum(np.vstack([np.zeros((window, moments.shape[1])), moments]), axis=0)
    tail = np.repeat(sums[-1:], window - 1, axis=0)
    sums = np.vstack([sums, tail])
    blocks = (sums[window:] - sums[:-window]) / np.sqrt(window)
    return upper_triangle(blocks).T
