"""Two-sided filtering: systems with poles inside and outside the unit circle, exact and bounded.

Source: 2018 kernel paper, section 3, equations (4), (5) and Remark 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ffl.errors import InputError
from ffl.systems.checked import checked
from ffl.systems.state_space import Array, StateSpace
from ffl.systems.zpk import CIRCLE_TOLERANCE, Zpk


@dataclass(frozen=True)
class Split:
    """H(q) = q^advance (causal(q) + anticausal(q^-1)).

    `causal` is strictly causal and runs forwards in time. `anticausal` holds the feedthrough, as in
    equation (5), and is stated in reversed time: filter the time-reversed input, reverse the result.
    """

    causal: StateSpace
    anticausal: StateSpace
    advance: int


@dataclass(frozen=True)
class Inversion:
    """Feedforward of an exact inverse on the samples -before .. N-1+after of the reference.

    `tail` is the 2-norm of the feedforward that lies outside that window, relative to the whole:
    what truncation of the infinite pre- and post-actuation leaves out.
    """

    feedforward: Array
    before: int
    after: int
    tail: float


def refuse_unit_circle(system: Zpk, what: str) -> None:
    """Raises `InputError` where a pole of `system` lies on the unit circle."""
    gap = np.abs(np.abs(system.poles) - 1.0)
    if gap.size and gap.min() < CIRCLE_TOLERANCE:
        root = system.poles[int(np.argmin(gap))]
        raise InputError(
            f"{what} has a pole at {root.real:.9g}{root.imag:+.9g}i on the unit circle, so it has no "
            "bounded two-sided response; move it off the circle or learn with a basis instead"
        )


def split(system: Zpk) -> Split:
    """Causal and anti-causal part of a system without poles on the unit circle, equation (5).

    The state space is brought to ordered real Schur form and decoupled by a Sylvester equation, so
    clustered and repeated poles need no partial fractions.
    """
    refuse_unit_circle(system, "the system")
    advance = max(0, -system.relative_degree)
    proper = Zpk(
        system.zeros, system.poles, system.gain, system.sample_time, system.delay + advance
    )
    ss = proper.state_space()
    t, q, k = scipy.linalg.schur(ss.a, output="real", sort="iuc")
    b, c = q.T @ ss.b, ss.c @ q
    a1, a2 = t[:k, :k], t[k:, k:]
    if 0 < k < ss.order:
        x = scipy.linalg.solve_sylvester(a1, -a2, -t[:k, k:])
        b = np.vstack([b[:k] - x @ b[k:], b[k:]])
        c = np.hstack([c[:, :k], c[:, :k] @ x + c[:, k:]])
    causal = StateSpace(a1, b[:k], c[:, :k], 0.0, ss.sample_time)
    back = np.linalg.inv(a2) if ss.order > k else a2
    anticausal = StateSpace(
        back,
        -back @ b[k:],
        c[:, k:] @ back,
        ss.d - c[:, k:] @ back @ b[k:],
        ss.sample_time,
    )
    return Split(causal, anticausal, advance)


def two_sided_filter(
    system: Zpk | Split, x: ArrayLike, before: int = 0, after: int = 0, hold: bool = False
) -> Array:
    """Bounded response to `x` of N samples, on the samples -before .. N-1+after.

    Outside its samples `x` is zero or, with `hold`, stays at its first and last value (a reference
    at rest before and after a move). The stable part is filtered forwards, the anti-stable part
    backwards; both are exact on the window, whatever its length: nothing is lost but what lies
    outside it. Cost O((N + before + after) n^2).
    """
    parts = system if isinstance(system, Split) else split(system)
    x = np.asarray(x, float)
    first, last = (x[0], x[-1]) if hold and len(x) else (0.0, 0.0)
    padded = np.concatenate([np.full(before, first), x, np.full(after + parts.advance, last)])
    forwards = parts.causal.filter(padded, steady_state(parts.causal, first))
    backwards = parts.anticausal.filter(padded[::-1], steady_state(parts.anticausal, last))
    y = forwards + backwards[::-1]
    return y[parts.advance : parts.advance + before + len(x) + after]


def steady_state(system: StateSpace, value: float) -> Array:
    """State at rest under the constant input `value`; the system has no pole at 1."""
    if value == 0.0 or system.order == 0:
        return np.zeros(system.order)
    return np.linalg.solve(np.eye(system.order) - system.a, system.b[:, 0] * value)


def two_sided_impulse(system: Zpk | Split, before: int, after: int) -> Array:
    """Impulse response theta_k, k = -before .. after, of equation (4); index `before` is k = 0."""
    return two_sided_filter(system, np.ones(1), before, after)


def settling_samples(system: Zpk, tolerance: float = 1e-12) -> tuple[int, int]:
    """Samples (before, after) until the slowest anti-stable and stable pole decay to `tolerance`."""
    radius = np.abs(system.poles)
    inside, outside = radius[radius < 1].max(initial=0.0), radius[radius > 1].min(initial=np.inf)
    extra = max(0, -system.relative_degree)

    def samples(rate: float) -> int:
        return 0 if rate < tolerance else int(np.ceil(np.log(tolerance) / np.log(rate)))

    return samples(1.0 / outside) + extra, samples(inside)


def exact_inverse(
    plant: Zpk,
    reference: ArrayLike,
    before: int | None = None,
    after: int | None = None,
    hold: bool = False,
) -> Inversion:
    """f = P^-1 r for a reference of N samples (2018 kernel paper, section 3). Outside these it is zero, so
    that one which ends elsewhere jumps back; with `hold` it stays at its first and last value, as a machine
    at rest does and as every basis has it.

    `before` and `after`, samples of f beside those of r, default to the decay of the slowest zero of P to
    1e-12, so nothing is cut. Raises `InputError` for a zero of P on the unit circle, a `reference` that is
    no list of finite numbers, and `before` or `after` that are no whole numbers from 0 on.
    """
    for name, samples in (("before", before), ("after", after)):
        if samples is not None and (int(samples) != samples or samples < 0):
            raise InputError(f"exact_inverse: {name} = {samples}: give a whole number from 0 on")
    x = checked(reference, "reference")
    inverse = plant.inverse()
    if np.any(np.abs(np.abs(inverse.poles) - 1.0) < CIRCLE_TOLERANCE):
        root = inverse.poles[int(np.argmin(np.abs(np.abs(inverse.poles) - 1.0)))]
        raise InputError(
            f"the plant has a zero at {root.real:.9g}{root.imag:+.9g}i on the unit circle, so its "
            "inverse is unbounded; learn with a basis, or leave that zero out of the model"
        )
    full_before, full_after = settling_samples(inverse)
    whole = two_sided_filter(inverse, x, full_before, full_after, hold)
    before = full_before if before is None else int(before)
    after = full_after if after is None else int(after)
    start, stop = full_before - before, full_before + len(x) + after
    lead, trail = max(0, -start), max(0, stop - len(whole))
    first, last = max(0, start), min(len(whole), stop)
    kept = np.pad(whole[first:last], (lead, trail), mode="edge")
    at_rest = np.sum((whole[:first] - whole[0]) ** 2), np.sum((whole[last:] - whole[-1]) ** 2)
    outside = np.sqrt(sum(at_rest))
    norm = float(np.linalg.norm(whole))
    return Inversion(kept, before, after, float(outside) / norm if norm else 0.0)
