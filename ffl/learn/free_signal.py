"""Norm-optimal update of the feedforward signal itself by a Riccati recursion, O(N) in time.

A dense lifted update takes 42 s and 488 MiB a matrix at N = 8000; the recursion goes on to 1e6.
"""

from __future__ import annotations

import time

import numpy as np
import scipy.linalg
from numba import njit
from numpy.typing import ArrayLike

from ffl.errors import InputError
from ffl.learn.norm_optimal import Update, UpdateReport
from ffl.learn.weights import Weights, apply_weight, as_filter, is_zero
from ffl.machines import linear_part
from ffl.systems import Plant, series
from ffl.systems.state_space import Array, StateSpace

SETTLING = 20000  # samples from the end after which the gain is first tried as stationary
SETTLED = 1e-14  # change of the cost to go from sample to sample, relative, that is none
FALLING = 0.01  # of the residual that a solve must at most leave, or the gain has not settled
OPTIMAL = 1e-10  # residual at which no further solve is worth its time


@njit(cache=True)
def _eliminate(t, k):  # type: ignore[no-untyped-def]
    """One Householder reflection: zeros below row k in column k of `t` (columns, rows), diagonal >= 0.

    The heaviest row comes to the top first: without that, rows of little weight lose their digits to
    those of a bound (Cox and Higham, 1998; KKT residuals of 1 in the place of 1e-9).
    """
    n_columns, n_rows = t.shape
    heaviest = k
    for i in range(k, n_rows):
        if abs(t[k, i]) > abs(t[k, heaviest]):
            heaviest = i
    if heaviest != k:
        for j in range(k, n_columns):
            t[j, k], t[j, heaviest] = t[j, heaviest], t[j, k]
    square = 0.0
    for i in range(k, n_rows):
        square += t[k, i] * t[k, i]
    if square == 0.0:
        return
    norm = np.sqrt(square)
    head = t[k, k]
    scale = 1.0 / (norm * (norm + abs(head)))
    sign = 1.0 if head > 0.0 else -1.0
    t[k, k] = head + sign * norm
    for j in range(k + 1, n_columns):
        product = 0.0
        for i in range(k, n_rows):
            product += t[k, i] * t[j, i]
        product *= scale
        for i in range(k, n_rows):
            t[j, i] -= product * t[k, i]
        t[j, k] *= -sign
    t[k, k] = norm
    for i in range(k + 1, n_rows):
        t[k, i] = 0.0


@njit(cache=True)
def _backwards(a, b, c, d, weight, target, gains, feed):  # type: ignore[no-untyped-def]
    """Cost to go V(x) = |L x - l|^2; fills feed (N) and gains; returns the first stationary t, or
    -1 - t where nothing weighs the input of sample t.

    One step is the QR of the rows w^1/2 (d, c, target) and (L b, L a, l): its first row gives u, the
    next ones L and l of the sample before. Formed as P = L'L instead, the weights of an interior
    point, twenty decades apart, leave P indefinite. With constant weights L converges going
    backwards; from there on, or where the rows of `gains` end, the gain is constant and only the
    vector L'l is carried. Row 0 of `gains` then holds the constant gain, row t - first + 1 the gain
    of sample t >= first.
    """
    n_samples, n_outputs = target.shape
    n = a.shape[0]
    constant = weight.shape[0] == 1
    factor = np.zeros((n + 1, n))  # columns of L, and l
    rows = np.zeros((n + 2, n_outputs + n))  # columns: u, x, right-hand side
    b_a = np.vstack((b.reshape(1, n), a.T))
    vector, following, gain = np.zeros(n), np.zeros(n), np.zeros(n)
    stationary = False
    first = 0
    square = 1.0
    for k in range(n_samples):
        t = n_samples - 1 - k
        w = weight[0] if constant else weight[t]
        if stationary:
            g = 0.0
            for i in range(n_outputs):
                g += w[i] * d[i] * target[t, i]
            for i in range(n):
                g += b[i] * vector[i]
            feed[t] = g / square
            for j in range(n):
                value = -gain[j] * g
                for i in range(n_outputs):
                    value += w[i] * c[i, j] * target[t, i]
                for i in range(n):
                    value += a[i, j] * vector[i]
                following[j] = value
            vector[:] = following
            continue
        for i in range(n_outputs):
            root = np.sqrt(w[i])
            rows[0, i] = root * d[i]
            for j in range(n):
                rows[j + 1, i] = root * c[i, j]
            rows[n + 1, i] = root * target[t, i]
        for j in range(n + 1):
            for i in range(n):
                rows[j, n_outputs + i] = 0.0
            for m in range(n):
                if b_a[j, m] != 0.0:
                    for i in range(m + 1):
                        rows[j, n_outputs + i] += b_a[j, m] * factor[m, i]
        for i in range(n):
            rows[n + 1, n_outputs + i] = factor[n, i]
        for j in range(min(n + 1, n_outputs + n)):
            _eliminate(rows, j)
        root = rows[0, 0]
        if root == 0.0:
            return -1 - t
        feed[t] = rows[n + 1, 0] / root
        row = k + 1 if constant else t
        for j in range(n):
            gain[j] = rows[j + 1, 0] / root
            if row < gains.shape[0]:
                gains[row, j] = gain[j]
        change = 0.0
        size = 0.0
        for j in range(n):
            for i in range(j + 1):
                value = rows[j + 1, i + 1]
                change = max(change, abs(value - factor[j, i]))
                size = max(size, abs(value))
                factor[j, i] = value
        for i in range(n):
            factor[n, i] = rows[n + 1, i + 1]
        if constant and (change <= SETTLED * size or k + 2 >= gains.shape[0]):
            stationary = True
            first = t
            square = root * root
            for j in range(n):
                gains[0, j] = gain[j]
                vector[j] = 0.0
                for i in range(j + 1):
                    vector[j] += factor[j, i] * factor[n, i]
    return first


@njit(cache=True)
def _forwards(a, b, gains, feed, constant, first, change):  # type: ignore[no-untyped-def]
    """change(t) = feed(t) - K(t) x(t), x(t+1) = A x(t) + B change(t)."""
    n = a.shape[0]
    n_samples = feed.shape[0]
    x = np.zeros(n)
    following = np.zeros(n)
    for t in range(n_samples):
        row = t
        if constant:
            row = 0 if t < first else n_samples - t
        value = feed[t]
        for j in range(n):
            value -= gains[row, j] * x[j]
        change[t] = value
        for i in range(n):
            total = b[i] * value
            for j in range(n):
                total += a[i, j] * x[j]
            following[i] = total
        for i in range(n):
            x[i] = following[i]


def minimiser(
    a: Array,
    b: Array,
    c: Array,
    d: Array,
    factors: Array,
    targets: Array,
    settling: int = SETTLING,
) -> Array:
    """argmin over u (N,) of sum factors (z - targets)^2, x(t+1) = a x + b u, z = c x + d u from rest.

    `factors` (1 or N, m), constant in time where they have one row; `targets` (N, m). With constant
    factors the gain is held from `settling` samples before the end on: exact for N up to that, an
    approximation beyond it where a mode converges more slowly (`FreeSignalUpdate.solve`).
    Cost O(N n^3), O(N n^2) from where the gain is held. Raises `InputError` where nothing weighs u.
    """
    samples = len(targets)
    constant = len(factors) == 1
    rows = min(samples, settling) + 1 if constant else samples
    gains = np.zeros((rows, len(b)))
    feed, change = np.zeros(samples), np.zeros(samples)
    first = _backwards(a, b, c, d, factors, targets, gains, feed)
    if first < 0:
        raise InputError(
            f"weights: nothing weighs the free signal at sample {-1 - first}; give feedforward or "
            "feedforward_change a value above zero there"
        )
    _forwards(a, b, gains, feed, constant, first, change)
    return change


class FreeSignalUpdate:
    """f_{j+1} = argmin of criterion (3) over the whole signal f, from initial rest.

    The three terms are three linear systems driven by the change f - f_j; their targets are
    G_e e_j, -G_f f_j and 0, and the minimiser is linear-quadratic tracking: L and l of the cost to go
    |L x - l|^2 backwards, by a QR a sample, the change forwards. Weights as in `Weights`; W_f + W_df
    must be positive, because f's last samples, fewer than the plant's relative degree from the end, do
    not reach the output. Of a model with effects the linear part counts, as in `NormOptimal`.
    """

    def __init__(self, model: Plant, reference: ArrayLike, weights: Weights) -> None:
        self.n = len(np.asarray(reference))
        weights.check_length(self.n)
        if is_zero(weights.feedforward) and is_zero(weights.feedforward_change):
            raise InputError(
                "weights: the free signal needs feedforward or feedforward_change above zero"
            )
        self.weights = weights
        self.loop = linear_part(model).require_stable()
        self.process_sensitivity = self.loop.process_sensitivity
        parts: list[StateSpace] = []
        factors: list[Array] = []
        t = model.sample_time
        for weight, system in (
            (weights.error, self.process_sensitivity),
            (weights.feedforward, None),
            (weights.feedforward_change, None),
        ):
            shaping, squared = as_filter(weight, t)
            parts.append(shaping if system is None else series(system, shaping))
            factors.append(np.ones(1) if squared is None else squared)
        self.a = scipy.linalg.block_diag(*[part.a for part in parts])
        self.b = np.concatenate([part.b[:, 0] for part in parts])
        self.c = scipy.linalg.block_diag(*[part.c for part in parts])
        self.d = np.array([part.d[0, 0] for part in parts])
        longest = max(len(factor) for factor in factors)
        self.factors = np.column_stack([np.broadcast_to(f, longest) for f in factors]).copy()

    def update(self, feedforward: Array, error: Array, command: Array | None = None) -> Update:
        """The next signal from trial j: its `feedforward` f_j and `error` e_j, shape (N,) each
        (`command` u_j only matters under bounds)."""
        start = time.perf_counter()
        change, residual = self.solve(feedforward, error)
        following = feedforward + change
        status = "optimal" if residual <= 1e-8 else "optimal_inaccurate"
        report = UpdateReport(time.perf_counter() - start, status, residual, self.n)
        return Update(following, following, report)

    def solve(self, feedforward: Array, error: Array) -> tuple[Array, float]:
        """The change of f (N,) and its KKT residual, by solves of what the ones before left.

        A gain held too early solves a problem whose states weigh a little less: the change it gives
        is off by that share, and the next solve takes the same share off the rest. On the flatbed
        printer, whose servo integrates, the gain goes on changing for 1e8 samples, and two or three
        solves leave 1e-10; where a solve does not pay, the gain is recursed to the first sample.
        Cost O(N) each.
        """
        change, residual, settling = np.zeros(self.n), np.inf, SETTLING
        while True:
            left = self.left(feedforward, error, change)
            step = minimiser(self.a, self.b, self.c, self.d, self.factors, left, settling)
            now = self.kkt(feedforward, error, change + step)
            falls = now < FALLING * residual
            if now < residual:
                change, residual = change + step, now
            if residual <= OPTIMAL or (not falls and settling >= self.n):
                return change, residual
            if not falls:
                settling = self.n

    def left(self, feedforward: Array, error: Array, change: Array) -> Array:
        """Targets of the criterion that are left after `change`: rounding does not add up."""
        own = StateSpace(self.a, self.b[:, None], self.c, self.d[:, None], 1.0)
        return self.targets(feedforward, error) - own.filter(change)

    def targets(self, feedforward: Array, error: Array) -> Array:
        """What the outputs of the recursion are to reach, (N, 3): G_e e_j, -G_f f_j and 0."""
        shaped = _shape(self.weights.error, error), -_shape(self.weights.feedforward, feedforward)
        return np.column_stack([*shaped, np.zeros(self.n)])

    def kkt(self, feedforward: Array, error: Array, change: Array) -> float:
        """Gradient of criterion (3) at f_j + change relative to that of its error term at f_j."""
        size = max(self.size(error), 1e-300)
        return float(np.linalg.norm(self.gradient(feedforward, error, change)) / size)

    def size(self, error: Array) -> float:
        """2-norm of half the gradient of the error term at f_j: what stationarity is relative to."""
        pulled = self.process_sensitivity.filter(_square(self.weights.error, error)[::-1])
        return float(np.linalg.norm(pulled))

    def gradient(self, feedforward: Array, error: Array, change: Array) -> Array:
        """Half the gradient of criterion (3) at f_j + change, filtered forwards and backwards."""
        w, sp = self.weights, self.process_sensitivity
        inner = _square(w.error, error - sp.filter(change))
        gradient = -sp.filter(inner[::-1])[::-1]
        gradient += _square(w.feedforward, feedforward + change)
        gradient += _square(w.feedforward_change, change)
        return gradient


def _shape(weight, signal):  # type: ignore[no-untyped-def]
    """W^(1/2) signal where the weight is a scalar or a filter; per-sample weights act later."""
    return signal if isinstance(weight, np.ndarray) else apply_weight(weight, signal)


def _square(weight, signal):  # type: ignore[no-untyped-def]
    """W signal: the square root applied forwards, then its adjoint."""
    once = apply_weight(weight, signal)
    return (
        apply_weight(weight, once[::-1])[::-1]
        if not isinstance(weight, np.ndarray)
        else weight * signal
    )
