"""What a sensor at its limit lost, as the noise around it foretells it.

The likeliest values x of a residual e where it was lost are those that leave its innovations least:

    min over x of |W (e + Z x)|^2,

W the steady whitening filter, Z the lost samples of one stretch after the other: (rows, length) tables of
the filter's impulse response, no more rows than it is long.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg

from ffl.diagnose.noise.whitening import Whitener
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.state_space import Array

ENDS = 1e-6  # of the largest of an impulse response: what comes after is left out
LONGEST = 2000  # samples of it
MOST = 0.9  # of all samples, lost


def seen_in(white: Array) -> int:
    """How many of the innovations `white` are of samples that were seen: of what was lost they are 0."""
    seen = int(np.count_nonzero(white))
    return seen if seen > (1.0 - MOST) * len(white) else len(white)


def mean_power(white: Array) -> float:
    """Of the innovations of what was seen."""
    return float(white @ white) / max(seen_in(white), 1)


def share_seen(trials: Sequence[Trial]) -> float:
    """Of all samples, those that were not lost: the innovations of the others are filled in as none."""
    lost = sum(int(t.lost.sum()) for t in trials if t.lost is not None)
    return 1.0 - min(lost / max(sum(map(len, trials)), 1), MOST)


def filled(
    whiteners: Sequence[Whitener], trials: Sequence[Trial], residuals: Sequence[Array]
) -> list[Array]:
    """`residuals`, one (N,) per recording, with the likeliest values where samples were lost."""
    out = []
    for whitener, trial, e in zip(whiteners, trials, residuals, strict=True):
        if trial.lost is None or not trial.lost.any() or trial.lost.all():
            out.append(e)
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[0], trial.lost.astype(int), [0]])))
        response = _response(whitener, len(e))
        full = np.where(trial.lost, 0.0, e)
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            rows = min(b - a + len(response), len(e) - a)
            left = whitener.steady(full)[a : a + rows]
            first = np.zeros(rows)
            first[: min(rows, len(response))] = response[:rows]
            table = scipy.linalg.toeplitz(first, np.zeros(b - a))
            full[a:b] = -np.linalg.lstsq(table, left, rcond=None)[0]
        out.append(full)
    return out


def _response(whitener: Whitener, samples: int) -> Array:
    h = whitener.impulse(min(samples, LONGEST))
    heard = np.flatnonzero(np.abs(h) > ENDS * np.abs(h).max())
    return h[: heard[-1] + 1]
