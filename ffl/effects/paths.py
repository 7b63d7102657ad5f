"""Paths of rate-independent hysteresis, for regressors: the state along a given motion."""

from __future__ import annotations

import numpy as np
from numba import njit

from ffl.systems.state_space import Array

# Times the force over one displacement, from which what hardens is followed no farther.
RUNAWAY = 1e3


@njit(cache=True, error_model="numpy")  # called from outside kernels too
def bouc_wen_step(z, move, displacement, exponent, beta, hardens=0.0):  # type: ignore[no-untyped-def]
    """z after a displacement `move` of one sign: dz = dx/displacement (1 - |z|^n ((1 - beta) +
    beta sign(z dx))); where it `hardens` (1.0) dz = dx/displacement (1 + |z|^n ((1 + beta) -
    beta sign(z dx))).

    In closed form for n = 1; else classical Runge-Kutta in pieces of at most 0.25 displacement.
    Beyond 40 displacements z is at its limit to the last digit.
    """
    way_out = 1.0 - 2.0 * hardens
    way_back = way_out * (1.0 - 2.0 * way_out * beta)
    side = 1.0 if move >= 0.0 else -1.0
    length = abs(move) / displacement
    if length > 40.0:
        length = 40.0
    w = side * z  # along the motion: dw/dlength = 1 - |w|^n (1 - beta + beta sign(w))
    if exponent == 1.0:
        return side * _linear_step(w, length, way_back, way_out)
    if hardens != 0.0:
        return side * _hardened(w, length, exponent, way_back, way_out)
    if w >= 1.0 - 1e-13:
        return side * w
    pieces = int(length / 0.25) + 1
    h = length / pieces
    for _ in range(pieces):
        w = min(_advanced(w, h, exponent, way_back, way_out), 1.0)
    return side * w


@njit(error_model="numpy")
def _advanced(w, h, exponent, way_back, way_out):  # type: ignore[no-untyped-def]
    """w after a piece h of the way, by Runge and Kutta."""
    k1 = _rate(w, exponent, way_back, way_out)
    k2 = _rate(w + 0.5 * h * k1, exponent, way_back, way_out)
    k3 = _rate(w + 0.5 * h * k2, exponent, way_back, way_out)
    k4 = _rate(w + h * k3, exponent, way_back, way_out)
    return w + h * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0


@njit(error_model="numpy")
def _hardened(w, length, exponent, way_back, way_out):  # type: ignore[no-untyped-def]
    """What hardens leaves all bounds after a finite way: pieces over which w changes by a quarter of itself
    at most, up to `RUNAWAY`."""
    while length > 0.0 and w < RUNAWAY:
        rate = _rate(w, exponent, way_back, way_out)
        h = min(length, 0.25, 0.25 * max(1.0, abs(w)) / rate)
        ahead = _advanced(w, h, exponent, way_back, way_out)
        if w < 0.0 < ahead:  # a piece ends where the law has its kink
            h *= w / (w - ahead)
            ahead = 0.0
        w = ahead
        length -= h
    return min(w, RUNAWAY)


@njit(error_model="numpy")
def _linear_step(w, length, share, onward):  # type: ignore[no-untyped-def]
    """n = 1: w' = 1 + share w up to w = 0, then w' = 1 - w, or 1 + w where `onward` is -1."""
    if w < 0.0:
        needed = -w if abs(share) < 1e-09 else -np.log1p(share * w) / share
        if length <= needed and abs(share) < 1e-9:
            return w + length
        if length <= needed:
            return w * np.exp(share * length) + np.expm1(share * length) / share
        w, length = 0.0, length - needed
    if onward < 0.0:
        return (1.0 + w) * np.exp(length) - 1.0
    return 1.0 - (1.0 - w) * np.exp(-length)


@njit(error_model="numpy")
def _rate(w, exponent, way_back, way_out):  # type: ignore[no-untyped-def]
    share = way_out if w >= 0.0 else way_back
    size = w * w if exponent == 2.0 else abs(w) ** exponent
    return 1.0 - share * size


@njit(cache=True, error_model="numpy")
def _bouc_wen(x, displacement, exponent, beta, hardens, z):  # type: ignore[no-untyped-def]
    for k in range(1, len(x)):
        z[k] = bouc_wen_step(z[k - 1], x[k] - x[k - 1], displacement, exponent, beta, hardens)


def bouc_wen(
    x: Array, displacement: float, exponent: float, beta: float, hardens: bool = False
) -> Array:
    """z along the positions `x` from z = 0. (n, beta) = (1, 1) is the Dahl model, z = force/level."""
    z = np.zeros(len(x))
    _bouc_wen(np.ascontiguousarray(x, float), displacement, exponent, beta, float(hardens), z)
    return z


@njit(cache=True, nogil=True, error_model="numpy")
def beyond(v0, v1, step):  # type: ignore[no-untyped-def]
    """By how much a motion of speeds `v0` and `v1` at the ends of a `step` went further than where it ends,
    at constant acceleration a: v1^2/(2 a) where it turned, in the direction of `v0`; nothing elsewhere."""
    return 0.5 * step * v1 * v1 / (v0 - v1) if v0 * v1 < 0.0 else 0.0


@njit(cache=True)
def _play(x, v, step, half, y):  # type: ignore[no-untyped-def]
    for k in range(1, len(x)):
        y[k] = y[k - 1]
        for at in (x[k] + beyond(v[k - 1], v[k], step), x[k]):
            y[k] = min(max(y[k], at - half), at + half)


def play(x: Array, gap: float, v: Array, step: float) -> Array:
    """Output of a play of total width `gap` along `x`, centred at the start and held as far as the motion
    went; `v`: its speed, `step`: between two samples."""
    y = np.array(x, float)
    _play(np.ascontiguousarray(x, float), np.ascontiguousarray(v, float), step, 0.5 * gap, y)
    return y
