"""Estimators of non-causal FIR inverses: least squares (3) and kernels (6)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffl.errors import InputError
from ffl.identify.estimator import Estimator, signals
from ffl.identify.evidence import maximise_evidence, reduced, unexplained
from ffl.identify.inverse import IdentifiedInverse
from ffl.identify.kernels import TC, Direct, Fixed, Kernel
from ffl.identify.noise import NoiseModel, fit_noise, whitened
from ffl.identify.regression import Edges, Regression, backward_regression, least_squares

Array = NDArray[np.float64]

NOISE_ROUNDS = 4


class Backward(Estimator, ABC):
    """fit: rows by the edge protocol, a solution, and where asked the colour of its residual.

    Feasible generalised least squares: solve, model the residual as AR, filter output and target,
    solve again; the noise model is settled after `NOISE_ROUNDS` rounds at the latest.
    """

    n_ac: int
    n_c: int
    edges: Edges
    noise: NoiseModel | int | str
    inverse_: IdentifiedInverse
    noise_variance_: float

    def fit(self, data: Any, target: ArrayLike | None = None, lead: int | None = None) -> Self:
        """Learns from a recording (y -> u) or from arrays output, target (y -> r).

        `lead`: how many output samples come before the first target sample (None: equal lengths).
        Learns `inverse_`, `noise_variance_`, `noise_model_`, `regression_` and `edges_` (in words).
        The regressor is taken as free of noise, as in section 2.2: noise on y wants `TwoStageInverse`
        (known input), a closed loop `InstrumentalInverse`.
        """
        output, values, sample_time = signals(data, target)
        regression = backward_regression(output, values, self.n_ac, self.n_c, self.edges, lead)
        colour = self.noise
        if isinstance(colour, NoiseModel):
            rows, rounds = whitened(regression, colour), 0
        elif colour == "white":
            rows, rounds = regression, 0
        elif colour == "coloured" or (isinstance(colour, int) and colour > 0):
            rows, rounds = regression, NOISE_ROUNDS
        else:
            raise InputError(
                f'noise = {colour!r}: give "white", "coloured", an AR order above 0 or a NoiseModel'
            )
        inverse = self._solve(rows)
        model = colour if isinstance(colour, NoiseModel) else NoiseModel(np.ones(1), 0.0)
        for _ in range(rounds):
            residual = regression.target - regression.apply(inverse.theta)
            model = fit_noise(residual, colour if isinstance(colour, int) else None)
            before, inverse = inverse, self._solve(whitened(regression, model))
            change = np.linalg.norm(inverse.theta - before.theta)
            if change <= 1e-6 * np.linalg.norm(inverse.theta):
                break
        self.regression_ = regression
        self.edges_ = regression.says
        self.noise_model_ = NoiseModel(model.filter, self.noise_variance_)
        self.inverse_ = replace(inverse, sample_time=sample_time)
        return self

    @abstractmethod
    def _solve(self, rows: Regression) -> IdentifiedInverse:
        """theta and its spread for white noise; learns `noise_variance_`."""

    def predict(self, reference: ArrayLike) -> Array:
        """Feedforward for a reference, with the whole preview."""
        return self._learned("inverse_").feedforward(reference)


class LeastSquaresInverse(Backward):
    """theta = argmin ||target - Phi theta||^2, equation (3), by QR.

    `n_ac` anti-causal and `n_c` causal taps beside k = 0; `edges` says what is assumed beyond the
    record; `noise` is "white", "coloured" (AR, order by BIC), an AR order, or a NoiseModel.
    """

    def __init__(
        self,
        n_ac: int = 50,
        n_c: int = 50,
        edges: Edges = Edges(),
        noise: NoiseModel | int | str = "white",
    ) -> None:
        self.n_ac = n_ac
        self.n_c = n_c
        self.edges = edges
        self.noise = noise

    def _solve(self, rows: Regression) -> IdentifiedInverse:
        theta = least_squares(rows)
        free = rows.n_rows - rows.n_taps
        self.noise_variance_ = rows.triangle.rest / free if free > 0 else 0.0
        return IdentifiedInverse(
            theta, self.n_ac, self.n_c, 1.0, self.noise_variance_, rows.triangle.r
        )


class KernelInverse(Backward):
    """Posterior mean of theta under a kernel, equation (6), hyperparameters by marginal likelihood.

    `kernel` None: TC on both sides plus direct terms at k = -3 .. 0. `noise_variance` None: learned
    with the hyperparameters. `learn` False: the kernel is used as given. The rest as for
    `LeastSquaresInverse`. Learns also `kernel_`, `log_evidence_`, `evidence_` and
    `effective_parameters_`.

    The posterior is that at the learned hyperparameters (poles excepted, see `Evidence.inverse`). Where
    the data speak its band holds: of the taps above a thousandth 94 to 97 % lie within the 95 % band
    (zero at 1.25 or minimum phase, 600 samples, noise 0.1); far below, where the kernel's decay and not
    the data says how large a tap is, the decay's own error counts: 75 % of all 81 or 61 taps.

    >>> import numpy as np
    >>> from ffl.identify.kernels import TC
    >>> rng = np.random.default_rng(0)
    >>> y = rng.standard_normal(400)
    >>> r = y[1:-1] - 0.5 * y[:-2] + 0.1 * rng.standard_normal(398)
    >>> model = KernelInverse(TC(), n_ac=5, n_c=20).fit(y, r, lead=1)
    >>> bool(np.abs(model.inverse_.theta[5:7] - [1.0, -0.5]).max() < 0.05)
    True
    """

    def __init__(
        self,
        kernel: Kernel | None = None,
        n_ac: int = 50,
        n_c: int = 50,
        edges: Edges = Edges(),
        noise: NoiseModel | int | str = "white",
        noise_variance: float | None = None,
        learn: bool = True,
    ) -> None:
        self.kernel = kernel
        self.n_ac = n_ac
        self.n_c = n_c
        self.edges = edges
        self.noise = noise
        self.noise_variance = noise_variance
        self.learn = learn

    def _solve(self, rows: Regression) -> IdentifiedInverse:
        power = float(np.mean(rows.target**2))
        kernel = self.kernel
        if kernel is None:
            gain = power / float(np.mean(rows.output**2))
            kernel = TC(gain) + Direct(max(-3, -self.n_ac), 0, gain)
        data, variance = reduced(rows, kernel), self.noise_variance
        learn_noise = variance is None
        found = maximise_evidence(
            data,
            rows.lags,
            kernel if self.learn else Fixed(kernel),
            unexplained(data, kernel, rows.lags) if variance is None else variance,
            learn_noise,
        )
        self.evidence_ = found
        self.kernel_ = found.kernel
        self.noise_variance_ = found.solution.noise_variance
        self.log_evidence_ = found.log_evidence
        self.effective_parameters_ = found.solution.effective_parameters
        return found.inverse(rows)
