"""Whole samples of dead time from the leading taps of a long ARX model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.stats

from ffl.identify.linear.signals import Signals, as_signals
from ffl.identify.regression import upper_triangle
from ffl.systems.state_space import Array


def estimate_delay(
    recordings: Signals | Sequence[Signals],
    feedthrough: bool = False,
    lags: int = 30,
    significance: float = 1e-3,
) -> int:
    """Dead time in samples beyond the one of a strictly proper plant (or beyond 0, `feedthrough`).

    In a long ARX regression with the youngest inputs as the last columns, the last entries of Q'y
    are, one by one, what each youngest tap still adds: their cumulated squares give the F test that
    the first j taps are zero. The answer is the largest j that the test accepts. One QR, O(N lags^2);
    valid under feedback through a controller with at least one sample of delay.
    """
    pieces = as_signals(recordings)
    shortest = min(len(p) for p in pieces)
    total = sum(len(p) for p in pieces)
    lags = int(min(lags, shortest // 4, total // 12))
    if lags < 2:
        return 0
    first = 0 if feedthrough else 1
    stack = np.zeros((0, 0))
    rows = 0
    for piece in pieces:
        y, u = piece.y, piece.force
        for start in range(lags, y.size, 20_000):
            t = np.arange(start, min(start + 20_000, y.size))
            columns: list[Array] = [np.ones(t.size)]
            columns += [y[t - lag] for lag in range(1, lags + 1)]
            columns += [u[t - lag] for lag in range(lags, first - 1, -1)]
            r = upper_triangle(np.column_stack([*columns, y[t]]))
            stack = r if not stack.size else upper_triangle(np.vstack([stack, r]))
            rows += t.size
    width = stack.shape[1] - 1
    rest = float(np.sum(stack[width:, -1] ** 2)) / max(rows - width, 1)
    added = np.cumsum(stack[:width, -1][::-1][: lags // 2] ** 2)
    j = np.arange(1, added.size + 1)
    p_values = scipy.stats.f.sf(added / j / max(rest, 1e-300), j, max(rows - width, 1))
    zero = p_values > significance
    return int(np.argmin(zero)) if not zero.all() else 0
