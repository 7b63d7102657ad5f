"""Direct Bayesian identification as an estimator: constructor stores, `fit` learns."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from ffl.errors import InputError
from ffl.identify.bayes.algorithm_1 import Algorithm1Fit, algorithm_1
from ffl.identify.bayes.posterior import Posterior, direct_posterior
from ffl.identify.bayes.records import Record, check_arrays, reduce_record
from ffl.identify.estimator import Estimator, force
from ffl.systems.checked import checked


class _DirectInverse(Estimator):
    """Taps theta(-n_ac..n_c-1) of the inverse system, as the 2025 paper counts them: the causal ones
    include lag 0, so that `n_c` is one more than a `KernelInverse` of the same lags has. `fit` takes
    input and output as the paper does, (u, y); the other estimators (y, u): a recording serves both."""

    n_ac: int
    n_c: int
    forward_length: int
    at_rest: bool
    theta_: np.ndarray  # once learned
    both_sides: ClassVar[bool]  # whether xi(t < 0) predicts y like the rest, see `Record`

    def _record(self, u: ArrayLike | Any, y: ArrayLike | None) -> Record:
        if y is None:
            if not (hasattr(u, "u") and hasattr(u, "y")):
                raise InputError("fit: give a recording with u and y, or two arrays (u, y)")
            u, y = force(u), u.y
        if self.n_ac < 0 or self.n_c < 1:
            raise InputError(
                f"n_ac = {self.n_ac}, n_c = {self.n_c}: n_ac must be 0 or more, n_c 1 or more"
            )
        u, y = check_arrays(u, y, self.n_ac + self.n_c)
        length, before = min(self.forward_length, len(y)), self.n_ac if self.both_sides else 0
        return reduce_record(u, y, length, self.at_rest, before)

    @property
    def taps_(self) -> np.ndarray:
        """tau of every entry of `theta_`, in samples: -n_ac..n_c-1."""
        self._learned("theta_")
        return np.arange(-self.n_ac, self.n_c)

    def feedforward(self, reference: ArrayLike) -> np.ndarray:
        """f(t) = sum_tau theta(tau) r(t - tau), r at rest before and after: it stays at its first and last
        value; shape (N,)."""
        r = checked(reference, "reference")
        padded = np.pad(r, (self.n_c - 1, self.n_ac), mode="edge")
        return np.convolve(padded, self._learned("theta_"), mode="valid")

    def standard_errors(self) -> np.ndarray:
        """Posterior standard deviation of every tap; what taps that were cut off do is not in it."""
        return np.sqrt(np.diag(self._learned("result_").covariance))

    def plot(self, ax: Any) -> Any:
        """Draws the taps with two posterior standard deviations either way on matplotlib axes `ax`."""
        error = 2 * self.standard_errors()
        ax.errorbar(
            self.taps_,
            self.theta_,
            error,
            color="C0",
            marker="o",
            ms=4,
            capsize=3,
            linestyle="none",
        )
        ax.axhline(0.0, color="black", linewidth=0.5)
        ax.set_xlabel("tau [samples]")
        ax.set_ylabel("theta [input unit / output unit]")
        return ax


class DirectBayesianInverse(_DirectInverse):
    """Posterior mean of a non-causal FIR inverse straight from noisy output data.

    y = sum_t xi(theta, t) u(. - t) + v, v white and normal, xi the bounded inverse of theta (8), with
    its part at t < 0, which (8) leaves out and the data rule out (`records.Record`); prior (9) with the
    hyperparameters and the noise variance integrated out (`prior`, `posterior`). Beyond 12 taps kernels
    without the smoothness of (9) stand beside it, and the standard errors are those over all of them.

    Parameters: `n_ac`, `n_c` non-causal and causal taps; `n_draws` of importance sampling;
    `n_decays` points of the grid of decays; `peak_reach` how far from the largest tap the kernel's
    peak may lie; `forward_length` samples of forward response that are modelled; `at_rest`: zero
    state before the record (otherwise its first `forward_length` rows are dropped).

    Learns `theta_`, `noise_variance_`, `hyperparameters_`, `result_` (frozen, with status,
    effective sample size, root count, chains where the fallback ran).

    Source: 2025 paper, section III, with the changes of `posterior`. Raises `InputError` for unequal
    lengths, NaN, a constant input, too few samples, no noise, no causal forward system.

    >>> from ffl.identify.bayes.protocol import paper_data
    >>> data = paper_data(3)
    >>> inverse = DirectBayesianInverse(n_ac=4, n_c=2)
    >>> inverse.fit(data.u[:60], data.y, rng=np.random.default_rng(1)).theta_.shape
    (6,)
    """

    both_sides = True

    def __init__(
        self,
        n_ac: int = 4,
        n_c: int = 2,
        n_draws: int = 3000,
        n_decays: int = 12,
        peak_reach: int = 1,
        forward_length: int = 256,
        at_rest: bool = True,
    ):
        self.n_ac = n_ac
        self.n_c = n_c
        self.n_draws = n_draws
        self.n_decays = n_decays
        self.peak_reach = peak_reach
        self.forward_length = forward_length
        self.at_rest = at_rest

    def fit(
        self,
        u: ArrayLike | Any,
        y: ArrayLike | None = None,
        rng: np.random.Generator | None = None,
    ) -> Self:
        """Learns from an input and an output, or from a recording; the same `rng`, the same answer."""
        record = self._record(u, y)
        rng = np.random.default_rng(0) if rng is None else rng
        self.result_: Posterior = direct_posterior(
            record, self.n_ac, self.n_c, rng, self.n_draws, self.n_decays, self.peak_reach
        )
        self.theta_ = self.result_.theta
        self.noise_variance_ = self.result_.noise_variance
        self.hyperparameters_ = self.result_.kernel
        return self


class Algorithm1Inverse(_DirectInverse):
    """Algorithm 1 of the 2025 paper (EM with Metropolis-Hastings); see `algorithm_1`.

    `as_printed` drops the 1/2 before log det in (16), as the paper prints it. The likelihood is (6) to
    (8): of the paper's system, whose zeros outside are far out, that asks for the same inverse.
    """

    both_sides = False

    def __init__(
        self,
        n_ac: int = 4,
        n_c: int = 2,
        as_printed: bool = False,
        n_draws: int = 100_000,
        burn_in: int = 10_000,
        max_iterations: int = 20,
        n_chains: int = 1,
        forward_length: int = 256,
        at_rest: bool = True,
    ):
        self.n_ac = n_ac
        self.n_c = n_c
        self.as_printed = as_printed
        self.n_draws = n_draws
        self.burn_in = burn_in
        self.max_iterations = max_iterations
        self.n_chains = n_chains
        self.forward_length = forward_length
        self.at_rest = at_rest

    def fit(
        self,
        u: ArrayLike | Any,
        y: ArrayLike | None = None,
        rng: np.random.Generator | None = None,
    ) -> Self:
        """Learns from an input and an output, or from a recording."""
        record = self._record(u, y)
        rng = np.random.default_rng(0) if rng is None else rng
        self.result_: Algorithm1Fit = algorithm_1(
            record,
            self.n_ac,
            self.n_c,
            rng,
            self.as_printed,
            self.n_draws,
            self.burn_in,
            self.max_iterations,
            n_chains=self.n_chains,
        )
        self.theta_ = self.result_.theta
        self.hyperparameters_ = self.result_.hyperparameters[-1]
        self.noise_variance_ = self.hyperparameters_.noise_variance
        return self
