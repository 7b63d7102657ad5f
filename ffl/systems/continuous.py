"""Continuous-time zeros, poles, gain, discretised by zero-order hold."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ffl.errors import InputError
from ffl.systems.state_space import StateSpace
from ffl.systems.zpk import Zpk


def zero_order_hold(
    zeros: ArrayLike, poles: ArrayLike, gain: float, sample_time: float
) -> StateSpace:
    """gain * prod(s - zeros) / prod(s - poles) under a zero-order hold, as discrete state space.

    The continuous state space is assembled section by section (the same sections serve, with s for
    z) and discretised by one matrix exponential of [[A, B], [0, 0]] T.
    """
    continuous = Zpk(np.asarray(zeros, complex), np.asarray(poles, complex), gain, sample_time)
    if continuous.relative_degree < 0:
        raise InputError("more zeros than poles, so it needs the future; add poles")
    ss = continuous.state_space()
    n = ss.order
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n:] = ss.a, ss.b
    exponential = scipy.linalg.expm(block * sample_time)
    return StateSpace(exponential[:n, :n], exponential[:n, n:], ss.c, ss.d, sample_time)
