"""Starting models: subspace from a long ARX predictor, realisation from a regularised FIR.

Subspace: the predictor's Markov parameters by QR of a long ARX regression (valid under feedback),
then the SVD of their Hankel matrix weighted by the past data: A. Chiuso, Automatica 43 (2007) 1034
(predictor-based subspace identification), M. Jansson, SSARX, SYSID 2003. One QR and one SVD give
every order.
Realisation: Ho-Kalman on an FIR whose taps carry a TC prior, hyperparameters by marginal
likelihood: T. Chen, H. Ohlsson, L. Ljung, Automatica 48 (2012) 1525.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from ffl.identify.linear.coordinates import Point, Structure, integrator_block
from ffl.identify.linear.signals import Signals
from ffl.identify.regression import upper_triangle
from ffl.systems.state_space import Array

CHUNK = 20_000


def _triangle(
    pieces: Sequence[Signals], lags: int, outputs: bool, delay: int, direct: bool
) -> tuple[Array, int]:
    """R of [constant, regressors lag by lag, y]; (R, rows). Column order lag 1 .. p, then u(t)."""
    stack = np.zeros((0, 0))
    rows = 0
    for piece in pieces:
        y, u = piece.y[delay:], piece.force[: len(piece) - delay]
        for start in range(lags, y.size, CHUNK):
            t = np.arange(start, min(start + CHUNK, y.size))
            columns = [np.ones(t.size)]
            for lag in range(1, lags + 1):
                if outputs:
                    columns.append(y[t - lag])
                columns.append(u[t - lag])
            if direct:
                columns.append(u[t])
            block = np.column_stack([*columns, y[t]])
            r = upper_triangle(block)
            stack = r if not stack.size else upper_triangle(np.vstack([stack, r]))
            rows += t.size
    return stack, rows


@dataclass(frozen=True)
class LongModel:
    """Markov parameters of the predictor, lag 1..p: `from_y`, `from_u` (p,), `direct`; weights."""

    from_y: Array
    from_u: Array
    direct: float
    constant: float
    past: Array  # (p, 2p) or (p, p) factor of the past data's covariance, columns lag by lag


def long_arx(pieces: Sequence[Signals], s: Structure, max_lags: int = 60) -> LongModel:
    """Least-squares ARX whose length Akaike's criterion chooses from one QR."""
    total = sum(len(p) for p in pieces)
    shortest = min(len(p) for p in pieces)
    lags = int(max(min(max_lags, total // 8, shortest // 3), s.order + 1))
    r, rows = _triangle(pieces, lags, True, s.delay, False)
    width = r.shape[1] - 1
    tail = np.cumsum(r[::-1, -1] ** 2)[::-1]  # residual sum of squares with the first j columns
    counts = 1 + 2 * np.arange(1, lags + 1)
    rss = np.array([tail[c] if c < tail.size else 0.0 for c in counts])
    aic = rows * np.log(np.maximum(rss, 1e-300)) + 2 * counts
    chosen = max(int(np.argmin(aic)) + 1, min(lags, 2 * s.order + 2))
    if s.feedthrough:
        r, rows = _triangle(pieces, chosen, True, s.delay, True)
        width = r.shape[1] - 1
    else:
        width = 1 + 2 * chosen
    theta, *_ = scipy.linalg.lstsq(r[:width, :width], r[:width, -1], cond=1e-12)
    lagged = theta[1 : 1 + 2 * chosen]
    return LongModel(
        lagged[0::2],
        lagged[1::2],
        float(theta[-1]) if s.feedthrough else 0.0,
        float(theta[0]),
        r[1 : 1 + 2 * chosen, 1 : 1 + 2 * chosen] / np.sqrt(rows),
    )


def regularised_fir(pieces: Sequence[Signals], s: Structure, taps: int = 250) -> LongModel:
    """FIR with prior covariance c lambda^max(i, j) (TC), (c, lambda, noise) by marginal likelihood.

    For each lambda one SVD of R times the prior's Cholesky factor makes the likelihood in c and the
    noise variance elementary; O(taps^3) whatever N is.
    """
    shortest = min(len(p) for p in pieces)
    taps = int(max(min(taps, shortest // 4), s.order + 1))
    r, rows = _triangle(pieces, taps, False, s.delay, s.feedthrough)
    p = r.shape[1] - 2
    # The constant carries no prior: the rows below the first are the data free of it.
    phi, z = r[1 : p + 1, 1 : p + 1], r[1 : p + 1, -1]
    rest = float(np.sum(r[p + 1 :, -1] ** 2))
    lag = np.append(np.arange(1, taps + 1), np.zeros(p - taps))
    ratios = np.geomspace(1e-6, 1e8, 43)[:, None]  # c over the noise variance, per output power
    best, theta = np.inf, np.zeros(p)
    for decay in (0.6, 0.75, 0.85, 0.9, 0.94, 0.965, 0.98, 0.99):
        kernel = decay ** np.maximum.outer(lag, lag)
        kernel[np.diag_indices(p)] *= 1.0 + 1e-10
        try:
            low = np.linalg.cholesky(kernel)
        except np.linalg.LinAlgError:  # a prior that has decayed below rounding
            continue
        u, sigma, vt = np.linalg.svd(phi @ low)
        inner = u.T @ z
        gain = 1.0 + ratios * sigma**2
        fit = np.sum(inner**2 / gain, axis=1) + rest
        value = rows * np.log(np.maximum(fit, 1e-300)) + np.sum(np.log(gain), axis=1)
        k = int(np.argmin(value))
        if value[k] < best:
            best = float(value[k])
            theta = low @ (vt.T @ (ratios[k] * sigma * inner / gain[k]))
    g = theta[:taps]
    direct = float(theta[taps]) if s.feedthrough else 0.0
    return LongModel(np.zeros(taps), g, direct, 0.0, np.zeros((0, 0)))


def realise(model: LongModel, order: int, use_outputs: bool) -> Point:
    """The `order` dominant states of the Markov parameters: Hankel, SVD, shift invariance."""
    p = model.from_u.size
    # lag k: C A~^(k-1) [K B~]
    used = [model.from_y, model.from_u] if use_outputs else [model.from_u]
    sequence = np.column_stack(used)
    m = sequence.shape[1]
    padded = np.vstack([sequence, np.zeros((p, m))])
    hankel = np.stack([padded[i : i + p].ravel() for i in range(p)])
    weight = model.past.T if model.past.size else np.eye(p * m)
    u, sigma, _ = np.linalg.svd(hankel @ weight, full_matrices=False)
    order = min(order, int(np.sum(sigma > 1e-12 * sigma[0])))
    root = np.sqrt(sigma[:order])
    observability = u[:, :order] * root
    # hankel = O K, hence K = O^+ hankel; its first block column holds [K B~].
    reach = (u[:, :order] / root).T @ hankel
    a_tilde, *_ = np.linalg.lstsq(observability[:-1], observability[1:], rcond=1e-12)
    c, gains = observability[0], reach[:, :m]
    k = gains[:, 0] if use_outputs else np.zeros(order)
    b_tilde = gains[:, -1]
    a = a_tilde + np.outer(k, c)
    return Point(a, b_tilde + k * model.direct, c, model.direct, k, 0.0)


def fit_structure(point: Point, s: Structure) -> Point:
    """The start brought to the structure.

    The `integrators` poles nearest 1 become the fixed block (in the basis ((A-I) b, b), where a
    double integrator is a Jordan block); missing states are appended as fast, weak ones.
    """
    m, have = s.order - s.integrators, point.a.shape[0]
    slow = min(s.integrators, have)
    a, b, c, k, near = _split_slowest(point, slow)
    n, have = s.order, a.shape[0]
    whole = np.zeros((n, n))
    kept = min(have, m)
    whole[:kept, :kept] = a[:kept, :kept]
    for i in range(kept, m):
        whole[i, i] = 0.3 / (1 + i - kept)
    whole[m:, m:] = integrator_block(s.integrators)
    vectors = []
    for value, fill in ((b, 0.1), (c, 0.1), (k, 0.0)):
        padded = np.zeros(n)
        padded[:kept] = value[:kept]
        padded[kept:m] = fill
        vectors.append(padded)
    if s.integrators:
        vectors[0][m:] = np.eye(s.integrators)[-1]
        if near is not None and near[0].size == s.integrators:
            vectors[1][m:], vectors[2][m:] = near
        else:
            vectors[1][m:], vectors[2][m:] = 1e-3, 0.05
    if not s.innovation:
        vectors[2][:] = 0.0
    d = point.d if s.feedthrough else 0.0
    return Point(whole, vectors[0], vectors[1], d, vectors[2], point.offset)


def _split_slowest(
    point: Point, count: int
) -> tuple[Array, Array, Array, Array, tuple[Array, Array] | None]:
    """(A, b, c, k) without the `count` poles nearest 1, and (c, k) of those in Jordan basis."""
    a, b, c, k = point.a, point.b, point.c, point.k
    if not count:
        return a, b, c, k, None
    distance = np.sort(np.abs(np.linalg.eigvals(a) - 1.0))
    threshold = distance[count - 1] * (1 + 1e-9)
    t, q, kept = scipy.linalg.schur(
        a, output="real", sort=lambda re, im: abs(complex(re, im) - 1.0) > threshold
    )
    b, c, k = q.T @ b, c @ q, q.T @ k
    if 0 < kept < len(b):
        x = scipy.linalg.solve_sylvester(t[:kept, :kept], -t[kept:, kept:], -t[:kept, kept:])
        c = np.concatenate([c[:kept], c[:kept] @ x + c[kept:]])
        b = np.concatenate([b[:kept] - x @ b[kept:], b[kept:]])
        k = np.concatenate([k[:kept] - x @ k[kept:], k[kept:]])
    slow = t[kept:, kept:]
    columns = [b[kept:]]
    for _ in range(slow.shape[0] - 1):
        columns.insert(0, slow @ columns[0] - columns[0])
    basis = np.column_stack(columns)
    near = None
    if np.linalg.cond(basis) < 1e8:
        near = c[kept:] @ basis, np.linalg.solve(basis, k[kept:])
    return t[:kept, :kept], b[:kept], c[:kept], k[:kept], near


def stabilise(a: Array, limit: float = 0.995) -> Array:
    """Poles outside radius `limit` that are unstable are drawn inside along their radius."""
    t, q = scipy.linalg.schur(a, output="complex")
    poles = np.diag(t).copy()
    outside = np.abs(poles) >= 1.0
    if not outside.any():
        return a
    poles[outside] = limit * poles[outside] / np.abs(poles[outside])
    t[np.diag_indices_from(t)] = poles
    return np.real(q @ t @ q.conj().T)
