"""Forward impulse response xi(theta) of a non-causal FIR inverse, through the roots of theta(z).

theta(z) = sum_{tau=-n_ac}^{n_c-1} theta(tau) z^-tau = z^-(n_c-1) Q(z), Q of degree n_ac + n_c - 1 with
theta, as stored, for its coefficients from the highest power down. In the annulus that contains
|z| = 1 (Theorem 1), for t >= 0,

    xi(t) = sum over roots |p| < 1 of  p^(t + n_c - 2) / Q'(p)   (+ 1/Q(0) at t = 0 where n_c = 1),

and for t < 0 minus the same sum over the roots |p| > 1.

Expanding in |z| > max |p| instead diverges: cutting the inverse to a few taps leaves parasitic
roots far outside. The roots follow theta by Aberth's simultaneous iteration from those of a
neighbouring theta, which makes one likelihood a few microseconds.
"""

import numpy as np
from numba import njit


def all_roots(theta: np.ndarray) -> np.ndarray:
    """Roots of Q from nothing (companion matrix); a vanishing leading tap gives one far outside."""
    c = np.array(theta, float)
    floor = 1e-12 * np.abs(c).max()
    lead = np.abs(c) > floor
    first = int(np.argmax(lead))
    found = np.roots(c[first:]).astype(complex)
    return np.concatenate([found, 1e6 * np.exp(2j * np.arange(len(c) - 1 - len(found)))])


@njit(cache=True)
def refine_roots(c, z):
    """Aberth iteration in place on the roots `z` of the polynomial `c` (highest power first).

    A start closed under conjugation stays so, and two real roots could never become a pair: hence
    the small turn, different for each root. Outside the disc the reversed polynomial is evaluated.
    """
    n = len(c) - 1
    for k in range(n):
        z[k] *= 1.0 + (k + 1) * 1e-3j / n
    for _ in range(80):
        largest = 0.0
        for k in range(n):
            zk = z[k]
            if abs(zk) <= 1.0:
                p, dp = c[0] + 0j, 0j
                for i in range(1, n + 1):
                    dp = dp * zk + p
                    p = p * zk + c[i]
                if p == 0:
                    continue
                newton = dp / p
            else:
                v = 1.0 / zk
                p, dp = c[n] + 0j, 0j
                for i in range(1, n + 1):
                    dp = dp * v + p
                    p = p * v + c[n - i]
                if p == 0:
                    continue
                newton = n * v - v * v * dp / p
            repulsion = 0j
            for j in range(n):
                if j != k and z[j] != zk:
                    repulsion += 1.0 / (zk - z[j])
            away = newton - repulsion
            if abs(away) * abs(zk) < 1e-14:  # a root at infinity: the leading tap is zero
                continue
            step = 1.0 / away
            z[k] = zk - step
            largest = max(largest, abs(step) / (abs(zk) + 1e-30))
        if largest < 1e-13:
            break
    return z


@njit(cache=True)
def response_from_roots(theta, z, n_c, xi, before=0):
    """Fills `xi` with xi(t), t = -before..len(xi)-before-1; returns how many roots lie inside."""
    n = len(theta) - 1
    xi[:] = 0.0
    if n_c == 1:
        xi[before] = 1.0 / theta[n]
    inside = 0
    for k in range(n):
        p = z[k]
        if abs(p) < 1.0:
            inside += 1
        elif before == 0:
            continue
        q, dq = theta[0] + 0j, 0j
        for i in range(1, n + 1):
            dq = dq * p + q
            q = q * p + theta[i]
        g = p ** (n_c - 2) / dq
        if abs(p) < 1.0:
            # a conjugate pair shares its work where the roots come out exactly conjugate; they
            # seldom do to the last bit, so each root simply adds its real part
            gr, gi, pr, pi = g.real, g.imag, p.real, p.imag
            for t in range(before, len(xi)):
                xi[t] += gr
                gr, gi = gr * pr - gi * pi, gr * pi + gi * pr
                if abs(gr) + abs(gi) < 1e-18:
                    break
        else:
            for t in range(before - 1, -1, -1):
                g /= p
                xi[t] -= g.real
    return inside


@njit(cache=True, fastmath={"reassoc", "contract"})  # sums in vector registers, NaN as it is
def misfit(factor, target, floor, xi):
    """||y - U xi||^2 from the triangular factor of U (see `records.Record`)."""
    total = floor
    n = len(target)
    for i in range(n):
        e = target[i]
        for j in range(i, n):
            e -= factor[i, j] * xi[j]
        total += e * e
    return total


@njit(cache=True)
def misfit_of_many(thetas, start, n_c, factor, target, floor, before=0):
    """Misfit and root count of every row of `thetas`, each from the same `start` roots."""
    n = len(thetas)
    values, counts = np.empty(n), np.empty(n, np.int64)
    xi = np.empty(len(target))
    for m in range(n):
        z = refine_roots(thetas[m], start.copy())
        counts[m] = response_from_roots(thetas[m], z, n_c, xi, before)
        values[m] = misfit(factor, target, floor, xi)
    return values, counts


def forward_response(
    theta: np.ndarray, n_ac: int, length: int, before: int = 0
) -> tuple[np.ndarray, int]:
    """xi(-before..length-1) of the FIR inverse `theta` (taps -n_ac..) and the number of roots inside.

    >>> xi, inside = forward_response(np.array([0.0, 1.0, -0.5]), 1, 4)   # 1 - 0.5 z^-1, causal
    >>> np.round(xi, 12).tolist(), inside
    ([1.0, 0.5, 0.25, 0.125], 1)
    """
    theta = np.asarray(theta, float)
    xi = np.empty(before + length)
    z = refine_roots(theta, all_roots(theta))
    return xi, int(response_from_roots(theta, z, len(theta) - n_ac, xi, before))
