"""A Kalman filter around what is clipped: a friction that takes off a speed what it can, a contact that
holds a stretch, a play within which a stretch is free.

For one number q = row x of a state x with covariance P, Gaussian,

    x' = x - kick (q - clip(q, -down, up)),   row kick = 1,

has mean, slope and what is left of the variance beside the slope in closed form: they are the moments of a
rectified Gaussian. A play that turns within a step is held as far as the peak, at constant acceleration
v1^2/(2 a) beyond where the step ends: by as much its wall has gone back when the step is over.

Where y itself jumps at a wall, as behind a play, its density has a peak for each side,

    p(y) = sum_i P(q on side i) N(y; y_i, S_i),

each side with the moments of a truncated Gaussian, weighed by what y says of it, and one Gaussian again.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

# A filter that is sure of a wrong side of a play stays there. Innovations of a mean square above LOST, over
# the last 1/MEMORY samples or so, say that it is; then it forgets where in the play it is.
LOST, MEMORY = 6.0, 0.1
UNLIKELY = 1e-12  # a side of a wall that is not looked at


@njit(cache=True, nogil=True, error_model="numpy")
def _beyond(depth, spread):  # type: ignore[no-untyped-def]
    """(probability of being above zero, mean and mean square of max(0, d)) of d, Gaussian about `depth`."""
    a = depth / spread
    if a > 8.0:
        return 1.0, depth, depth * depth + spread * spread
    if a < -8.0:
        return 0.0, 0.0, 0.0
    share = 0.5 * (1.0 + math.erf(a * 0.7071067811865476))
    bell = 0.3989422804014327 * math.exp(-0.5 * a * a)
    square = (a * a + 1.0) * share + a * bell
    return share, spread * (a * share + bell), spread * spread * square


@njit(cache=True, nogil=True, error_model="numpy")
def _level(grid, values, x):  # type: ignore[no-untyped-def]
    """Straight between knots, constant beyond the ends."""
    if x <= grid[0]:
        return values[0]
    for k in range(1, len(grid)):
        if x < grid[k]:
            share = (x - grid[k - 1]) / (grid[k] - grid[k - 1])
            return values[k - 1] + share * (values[k] - values[k - 1])
    return values[-1]


@njit(cache=True, nogil=True, error_model="numpy")
def _seen(x, p, row, out):  # type: ignore[no-untyped-def]
    """(mean, variance) of row x; `out` becomes p row."""
    n = len(x)
    mean, square = 0.0, 0.0
    out[:] = 0.0
    for j in range(n):
        weight = row[j]
        if weight != 0.0:
            mean += weight * x[j]
            for i in range(n):
                out[i] += p[j, i] * weight
    for i in range(n):
        square += row[i] * out[i]
    return mean, square


@njit(cache=True, nogil=True, error_model="numpy")
def _clip(x, p, pq, q, square, kick, up, down, held):  # type: ignore[no-untyped-def]
    """What `q`, of variance `square` and with pq = P row, is beyond up and -down is taken off x and P
    (`held`), or what it is within them."""
    doubt = np.sqrt(max(square, 1e-300))
    above, mean_above, square_above = _beyond(q - up, doubt)
    below, mean_below, square_below = _beyond(-q - down, doubt)
    left, slope = mean_above - mean_below, above + below
    rest = max(square_above + square_below - left * left - slope * slope * square, 0.0)
    # p' = (1 - g kick row) p (...)' + rest kick kick', g the share that is taken off
    g, change = (slope, left) if held else (1.0 - slope, q - left)
    for i in range(len(x)):
        x[i] -= kick[i] * change
        for j in range(i + 1):
            total = p[i, j] - g * (kick[i] * pq[j] + pq[i] * kick[j])
            total += (g * g * square + rest) * kick[i] * kick[j]
            p[i, j] = total
            p[j, i] = total


@njit(cache=True, nogil=True, error_model="numpy")
def _side(low, high):  # type: ignore[no-untyped-def]
    """(probability, mean, variance) of a standard Gaussian between `low` and `high`."""
    if low > 0.0:  # the side where tails are exact
        share, mean, square = _side(-high, -low)
        return share, -mean, square
    share = 0.5 * (math.erfc(-high * 0.7071067811865476) - math.erfc(-low * 0.7071067811865476))
    if share < UNLIKELY:
        return 0.0, high, 0.0
    one = 0.3989422804014327 * math.exp(-0.5 * low * low) if low > -40.0 else 0.0
    two = 0.3989422804014327 * math.exp(-0.5 * high * high) if abs(high) < 40.0 else 0.0
    mean = (one - two) / share
    square = 1.0 - mean * mean
    if one > 0.0:
        square += low * one / share
    if two > 0.0:
        square -= high * two / share
    return share, mean, max(square, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _behind_play(x, p, pq, xs, gains, row, stretch, walls, y, white):  # type: ignore[no-untyped-def]
    """(innovation, its standard deviation, logarithm of the density of y) with x and p brought to what y
    tells; the first two on the side of the play that is the likeliest then. pq (n,), xs and gains (3, n):
    room. On a side p is less by what its stretch, of covariance c with all, tells of the rest, and what y
    then does,

        p - (1 - square) c c'/c_stretch - g g'/s,   g of y on that side,

    and beyond a wall the stretch is known: all three are one sum of outer products."""
    n = len(x)
    c = p[stretch].copy()
    below, above = walls
    doubt = max(np.sqrt(max(c[stretch], 0.0)), 1e-9)
    low, high = (below - x[stretch]) / doubt, (above - x[stretch]) / doubt
    _seen(x, p, row, pq)
    leans = 0.0
    for i in range(n):
        leans += row[i] * c[i]
    logs, errors, powers, known = np.full(3, -np.inf), np.zeros(3), np.ones(3), np.zeros(3)
    for k in range(3):  # below, within, above
        if k == 0:
            share, mean, square = _side(-np.inf, low)
        elif k == 1:
            share, mean, square = _side(low, high)
        else:
            share, mean, square = _side(high, np.inf)
        if share < UNLIKELY:
            continue
        known[k] = (1.0 - square) / doubt**2
        own = 0.0 if k == 1 else row[stretch]  # of y that a wall makes certain
        less = own + known[k] * (leans - own * c[stretch])
        for i in range(n):
            xs[k, i] = x[i] + c[i] / doubt * mean
            gains[k, i] = pq[i] - c[i] * less
        if k != 1:
            xs[k, stretch] = above if k == 2 else below
            gains[k, stretch] = 0.0
        e, s = y, white
        for i in range(n):
            e -= row[i] * xs[k, i]
            s += row[i] * gains[k, i]
        errors[k], powers[k] = e, s
        logs[k] = np.log(share) - 0.5 * (np.log(2.0 * np.pi * s) + e * e / s)
        for i in range(n):
            xs[k, i] += gains[k, i] * e / s
    best = int(np.argmax(logs))
    shares = np.exp(logs - logs[best])
    total = shares.sum()
    shares /= total
    x[:] = 0.0
    for k in range(3):
        if shares[k] > 0.0:
            for i in range(n):
                x[i] += shares[k] * xs[k, i]
    told = (shares * known).sum()
    for i in range(n):
        for j in range(i + 1):
            p[i, j] -= told * c[i] * c[j]
    for j in range(n):  # what doubt of its stretch there is, is that of the side within
        value = shares[1] * (1.0 - known[1] * c[stretch]) * c[j]
        p[max(stretch, j), min(stretch, j)] = value
    for k in range(3):
        if shares[k] > 0.0:
            for i in range(n):
                xs[k, i] -= x[i]
            per = shares[k] / powers[k]
            for i in range(n):
                one, two = shares[k] * xs[k, i], per * gains[k, i]
                for j in range(i + 1):
                    p[i, j] += one * xs[k, j] - two * gains[k, j]
    for i in range(n):
        for j in range(i):
            p[j, i] = p[i, j]
    return errors[best], np.sqrt(powers[best]), logs[best] + np.log(total)


@njit(cache=True, nogil=True, error_model="numpy")
def _along(row, x):  # type: ignore[no-untyped-def]
    """row x."""
    total = 0.0
    for i in range(len(x)):
        total += row[i] * x[i]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _turned(half, before, after):  # type: ignore[no-untyped-def]
    """(low, high) walls of a play of +-half after a step, by the ways per step that the speeds at its two
    ends make: where it turned at its peak, one wall is held there and has gone back since."""
    if before * after >= 0.0:
        return -half, half
    # As `paths.beyond`, which numba's cache of this file would not see change.
    back = min(0.5 * after * after / abs(before - after), 2.0 * half)
    return (-half, half - back) if before > 0.0 else (back - half, half)


@njit(cache=True, nogil=True, error_model="numpy")
def predicted(  # type: ignore[no-untyped-def]
    y, drive, lean, x, p, move, colour, renewed, steps, row, spot, friction, kick, table, ease, bristle,
    stretch, half, again, white, rate, rates,
):  # fmt: skip
    """(innovations (N,), their standard deviations (N,), of a scale that with the innovation gives the
    likelihood, the logarithms (N,)).

    State x (n,) with covariance p, at the first sample before its y is seen; its last are noises, held over
    a sample and then `colour` (c,) of themselves, with variances `renewed` (c,) of what is new. move
    (n, n) and drive (N, n), of all forces known: one of the `steps` of a sample, with nothing clipped; lean
    (N, n): what a play's stretch adds to drive, or nothing (0, n).
    row, spot, friction (n,): y, the position at the friction's point and the speed there; kick (n,): of a
    force there that changes that speed by 1. table (3, k): positions, and what the friction takes off the
    speed in a step there, moving up and down. ease: how much more of it at rest, as a share and as that,
    and the speed over which that falls. `bristle`: friction and kick are those of a contact's stretch, and
    it is the stretch that the table bounds. stretch: which state is that of a play, held within +-half (0:
    none); again (n, n): added to p where the innovations say that the filter has lost it. white: variance
    of y's white noise.
    """
    n, samples = len(x), len(y)
    out, scale, logs = np.empty(samples), np.empty(samples), np.empty(samples)
    other, new, pq = np.empty((n, n)), np.empty(n), np.empty(n)
    xs, gains = np.zeros((3, n)), np.zeros((3, n))
    own, now = np.zeros(n), move.copy()
    own[stretch] = 1.0
    many, at = np.zeros(n, np.int64), np.zeros((n, n), np.int64)  # of each row what is not zero
    for i in range(n):
        for j in range(n):
            if move[i, j] != 0.0 or (j == stretch and len(lean) > 0):
                at[i, many[i]] = j
                many[i] += 1
    surprise, walls = 1.0, (-half, half)
    for t in range(samples):
        if half > 0.0:
            e, deviation, log = _behind_play(x, p, pq, xs, gains, row, stretch, walls, y[t], white)
            out[t], scale[t] = e, deviation
            white_square = e * e / (deviation * deviation)
            logs[t] = -log - 0.5 * (white_square + np.log(2.0 * np.pi))
            surprise += MEMORY * (min(white_square, 10.0 * LOST) - surprise)
            if surprise > LOST:
                surprise = 1.0
                p += again
        else:
            seen, s = _seen(x, p, row, pq)
            s += white
            e = y[t] - seen
            out[t], scale[t] = e, np.sqrt(s)
            logs[t] = 0.5 * np.log(s)
            for i in range(n):
                gain = pq[i] / s
                x[i] += gain * e
                for j in range(n):
                    p[i, j] -= gain * pq[j]
        if len(lean):
            for i in range(n):
                now[i, stretch] = move[i, stretch] + lean[t, i]
        before = rates[t] + _along(rate, x) if half > 0.0 else 0.0
        for step in range(steps):
            for i in range(n):
                new[i] = drive[t, i]
                for j in range(n):
                    other[i, j] = 0.0
                for c in range(many[i]):
                    k = at[i, c]
                    value = now[i, k]
                    new[i] += value * x[k]
                    for j in range(n):
                        other[i, j] += value * p[k, j]
            for i in range(n):
                x[i] = new[i]
                for j in range(i + 1):
                    total = 0.0
                    for c in range(many[j]):
                        k = at[j, c]
                        total += other[i, k] * now[j, k]
                    p[i, j] = total
                    p[j, i] = total
            place = _along(spot, x)
            v, square = _seen(x, p, friction, pq)
            bell = 0.0
            if ease[0] != 0.0 or ease[1] != 0.0:  # the mean of exp(-(v/w)^2) over the doubt
                width = 1.0 + 2.0 * square / (ease[2] * ease[2])
                bell = math.exp(-v * v / (ease[2] * ease[2] * width)) / np.sqrt(width)
            more = 1.0 + ease[0] * bell
            rising = more * _level(table[0], table[1], place) + ease[1] * bell
            falling = more * _level(table[0], table[2], place) + ease[1] * bell
            if rising > 0.0 or falling > 0.0 or bristle:
                _clip(x, p, pq, v, square, kick, rising, falling, bristle)
            if half > 0.0:
                after = rates[t] + _along(rate, x)
                walls, before = _turned(half, before, after), after
                if step < steps - 1:  # the last one when y is seen
                    z, square = _seen(x, p, own, pq)
                    _clip(x, p, pq, z, square, own, walls[1], -walls[0], True)
        for k in range(len(colour)):
            place = n - len(colour) + k
            x[place] *= colour[k]
            for j in range(n):
                p[place, j] *= colour[k]
                p[j, place] *= colour[k]
            p[place, place] += renewed[k]
    return out, scale, logs
