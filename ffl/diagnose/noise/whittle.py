"""Whittle's likelihood of noise with physics in it, and its gradient, compiled: a fit asks for hundreds."""

from __future__ import annotations

import numpy as np
from numba import njit

LEAST = 1e-150  # density at least: it is squared


@njit(cache=True, nogil=True, error_model="numpy")
def first_order(corner, step, cosine):  # type: ignore[no-untyped-def]
    """(density of a first-order process of unit variance with its corner at `corner` Hz where 2 pi f T has
    this cosine, its derivative by the logarithm of the corner)."""
    a = np.exp(-2.0 * np.pi * corner * step)
    bottom = 1.0 - 2.0 * a * cosine + a * a
    value = (1.0 - a * a) / bottom
    by_a = (-2.0 * a - value * (2.0 * a - 2.0 * cosine)) / bottom
    return value, -by_a * a * 2.0 * np.pi * corner * step


@njit(cache=True, nogil=True, error_model="numpy")
def whittle(p, sensor, force, cosine, step, power, weight, floor):  # type: ignore[no-untyped-def]
    """(sum of weight (log density + power/density), its gradient (k,)) over the bands (n,).

    p (k,), logarithms: sensor noise and force noise; with k = 6 also, of either, its coloured part as a
    share of the white one and that part's corner in Hz. sensor, force (n,): |S|^2 and |SP|^2; cosine (n,):
    cos(2 pi f T); step: T; floor: sensor noise that is there in any case.
    """
    value, gradient = 0.0, np.zeros(len(p))
    e = np.exp(p)
    squares = e * e
    coloured = len(p) > 2
    for k in range(len(power)):
        white, pushed = sensor[k] * squares[0], force[k] * squares[1]
        density = white + pushed + sensor[k] * floor * floor
        slow, turn, slow_force, turn_force = 0.0, 0.0, 0.0, 0.0
        if coloured:
            colour, slope = first_order(e[3], step, cosine[k])
            slow, turn = white * squares[2] * colour, white * squares[2] * slope
            colour, slope = first_order(e[5], step, cosine[k])
            slow_force, turn_force = pushed * squares[4] * colour, pushed * squares[4] * slope
            density += slow + slow_force
        density = max(density, LEAST)
        share = power[k] / density
        value += weight[k] * (np.log(density) + share)
        factor = weight[k] * (1.0 - share) / density
        gradient[0] += factor * 2.0 * (white + slow)
        gradient[1] += factor * 2.0 * (pushed + slow_force)
        if coloured:
            gradient[2] += factor * 2.0 * slow
            gradient[3] += factor * turn
            gradient[4] += factor * 2.0 * slow_force
            gradient[5] += factor * turn_force
    return value, gradient
