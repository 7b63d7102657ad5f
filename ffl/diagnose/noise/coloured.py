"""Linear regression in coloured noise: generalised least squares with an autoregressive residual.

The noise is that of the richest hypothesis, one for all: fitted beside each of them it swallows slow
physics (a delay that was 97 % of a difference brought nothing). Standard errors are the larger of the
innovations' and those of leaving out whole blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffl.systems.state_space import Array

ORDERS = 12
ROUNDS = 6
BLOCKS = 10


@dataclass(frozen=True)
class Regression:
    """`values` with `covariance`, `spread` of the innovations, of `n`; `log_likelihood` of the
    fitted, `held_out` of every block foretold by the others; `jackknife` standard errors; `left_out`:
    targets less what the other blocks foretell of them, about their mean."""

    values: Array
    covariance: Array
    spread: float
    log_likelihood: float
    held_out: float
    jackknife: Array
    left_out: Array

    @property
    def std_errors(self) -> Array:
        """The larger of both."""
        return np.maximum(np.sqrt(np.diag(self.covariance)), self.jackknife)


def order_of(pieces: Sequence[Array]) -> int:
    """Of the autoregression that foretells best, by Akaike's criterion."""
    n = sum(len(p) for p in pieces)
    top = int(min(ORDERS, max(1, n // 40)))
    scores = []
    for order in range(1, top + 1):
        _, variance = autoregression(pieces, order, top)
        scores.append(n * np.log(max(variance, 1e-300)) + 2.0 * order)
    return 1 + int(np.argmin(scores))


def autoregression(
    pieces: Sequence[Array], order: int, first: int | None = None
) -> tuple[Array, float]:
    """Coefficients phi of x(k) = sum phi_i x(k-i) + w, and the variance of w; rows from `first` on."""
    first = order if first is None else first
    rows = [lagged(p, order)[first - order :] for p in pieces]
    table, target = np.concatenate(rows), np.concatenate([p[first:] for p in pieces])
    q, r = np.linalg.qr(table)
    if np.abs(np.diag(r)).min(initial=1.0) <= 1e-12 * np.abs(r).max(initial=1e-300):
        return np.zeros(order), float(np.mean(target**2))
    phi = np.linalg.solve(r, q.T @ target)
    return phi, float(np.mean((target - table @ phi) ** 2))


def lagged(x: Array, order: int) -> Array:
    """(n - order, order): x(k-1) ... x(k-order) for k from `order` on."""
    return np.column_stack([x[order - i - 1 : len(x) - i - 1] for i in range(order)])


def whitened(x: Array, phi: Array) -> Array:
    """x(k) - sum phi_i x(k-i) from sample len(phi) on, (n - order,) or (n - order, columns)."""
    out = x[len(phi) :].copy()
    for i, value in enumerate(phi):
        out -= value * x[len(phi) - i - 1 : len(x) - i - 1]
    return out


def noise_beside(targets: Sequence[Array], tables: Sequence[Array], order: int) -> Array:
    """Autoregression of what the columns leave of `targets`, fitted together with them."""
    scale = np.sqrt(sum((t**2).sum(axis=0) for t in tables))
    scaled = [t / np.maximum(scale, 1e-300) for t in tables]
    phi = np.zeros(0)
    for _ in range(ROUNDS):
        rows = np.concatenate([whitened(t, phi) for t in scaled])
        right = np.concatenate([whitened(y, phi) for y in targets])
        values = np.linalg.lstsq(rows, right, rcond=1e-9)[0]
        left = [y - t @ values for y, t in zip(targets, scaled, strict=True)]
        phi, _ = autoregression(left, order)
    return phi


def regress(targets: Sequence[Array], tables: Sequence[Array], phi: Array) -> Regression | None:
    """Values of the columns of `tables`, one (n, k) table per piece, that explain `targets` in noise
    of the autoregression `phi`; None where the columns depend on one another."""
    scale = np.sqrt(sum((t**2).sum(axis=0) for t in tables))
    if not np.all(scale > 0):
        return None
    scaled = [t / scale for t in tables]
    rows = np.concatenate([whitened(t, phi) for t in scaled])
    right = np.concatenate([whitened(y, phi) for y in targets])
    q, r = np.linalg.qr(rows)
    size = np.abs(np.diag(r))
    if size.min() < 1e-7 * size.max():
        return None
    values = np.linalg.solve(r, q.T @ right)
    n, k = rows.shape
    errors = right - rows @ values
    variance = float(errors @ errors) / max(n - k, 1)
    inverse = np.linalg.inv(r)
    parts = np.array_split(np.arange(n), BLOCKS)
    foretold, estimates = np.empty(n), np.empty((BLOCKS, k))
    for i, part in enumerate(parts):
        # Leaving rows out by the hat matrix of the block: no further factorisation.
        own = q[part]
        less, seen = np.eye(k) - own.T @ own, own.T @ errors[part]
        change = errors[part] + own @ np.linalg.lstsq(less, seen, rcond=None)[0]
        foretold[part] = right[part] - change
        estimates[i] = values - inverse @ (own.T @ change)
    spread = (BLOCKS - 1) / BLOCKS * ((estimates - estimates.mean(axis=0)) ** 2).sum(axis=0)
    outside = right - foretold
    order, left, at = len(phi), [], 0
    block = np.repeat(np.arange(BLOCKS), [len(p) for p in parts])
    for y, t in zip(targets, scaled, strict=True):
        end = at + len(y) - order
        rest = y[order:] - np.sum(t[order:] * estimates[block[at:end]], axis=1)
        left.append(rest - rest.mean())
        at = end
    return Regression(
        values / scale,
        variance * (inverse @ inverse.T) / np.outer(scale, scale),
        float(np.sqrt(variance)),
        -0.5 * n * np.log(max(float(errors @ errors) / n, 1e-300)),
        -0.5 * n * np.log(max(float(outside @ outside) / n, 1e-300)),
        np.sqrt(spread) / scale,
        np.concatenate(left),
    )
