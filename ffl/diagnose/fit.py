"""Fitting a hypothesis: whitened output error by Levenberg and Marquardt, likelihood with noise."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

from ffl.diagnose.model import Model
from ffl.diagnose.noise import Noise, fit_noise
from ffl.diagnose.trials import Trial
from ffl.diagnose.whitening import Whitener
from ffl.errors import InputError
from ffl.systems.loop import Loop
from ffl.systems.state_space import Array

WORST = 1e30


@dataclass(frozen=True)
class Scene:
    """What every hypothesis is judged by: recordings, the loop that colours noise, the noise."""

    loop: Loop
    trials: tuple[Trial, ...]
    noise: Noise
    floor: float = 0.0
    free_clocks: bool = False  # the recordings' clocks overlap: their offsets are unknown

    @cached_property
    def whiteners(self) -> tuple[Whitener, ...]:
        shared: Whitener | None = None
        out = []
        for trial in self.trials:
            if not trial.doubt.any():
                shared = shared or Whitener.of(self.loop, self.noise)
                out.append(shared)
            else:
                out.append(Whitener.of(self.loop, self.noise, trial.doubt))
        return tuple(out)

    @cached_property
    def log_scale(self) -> float:
        return sum(w.log_scale(len(t)) for w, t in zip(self.whiteners, self.trials, strict=True))

    @property
    def samples(self) -> int:
        return sum(len(t) for t in self.trials)

    def residuals(self, model: Model) -> list[Array] | None:
        """y - yhat of each recording; None where the simulation leaves all bounds."""
        out = []
        for trial in self.trials:
            try:
                run = model.simulate(trial)
            except InputError:
                return None
            if run.diverged:
                return None
            out.append(trial.y - run.y)
        return out

    def whiten(self, residuals: Sequence[Array]) -> Array:
        return np.concatenate([w(e) for w, e in zip(self.whiteners, residuals, strict=True)])

    def with_noise_of(
        self, residuals: Sequence[Array], coloured: bool = True, quantile: float | None = None
    ) -> Scene:
        """The scene with the noise that these residuals would be, were they all noise (`quantile`:
        a lower envelope, see `noise.spectrum`)."""
        noise = fit_noise(
            self.loop, residuals, self.noise, floor=self.floor, coloured=coloured, quantile=quantile
        )
        return replace(self, noise=noise)

    def log_likelihood(self, white: Array) -> float:
        return float(-0.5 * (white @ white) - self.log_scale)


@dataclass(frozen=True)
class Fit:
    """A hypothesis at its best point: whitened residual, its Jacobian, and the likelihood.

    `jacobian` (N, p) is of the whitened prediction, in units of theta.
    """

    model: Model
    white: Array
    jacobian: Array
    status: str

    @property
    def cost(self) -> float:
        """Sum of squares of the whitened residual."""
        return float(self.white @ self.white)

    @cached_property
    def spread(self) -> Array:
        """Standard deviation of theta; infinite where the data see nothing."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @cached_property
    def covariance(self) -> Array:
        """(J'J)^-1 by SVD with directions below 1e-9 of the largest left infinite."""
        j = self.jacobian
        if j.shape[1] == 0:
            return np.zeros((0, 0))
        scale = np.maximum(np.linalg.norm(j, axis=0), 1e-150)  # its square must not vanish
        r = scipy.linalg.qr(j / scale, mode="r")[0][: j.shape[1]]
        _, s, vt = np.linalg.svd(r)
        s = np.where(s < 1e-9 * s[0], 1e-9 * s[0], s)
        half = vt.T / s
        inflate = max(1.0, self.cost / max(len(self.white) - j.shape[1], 1))
        return inflate * (half @ half.T) / np.outer(scale, scale)


_POOL = ThreadPoolExecutor(2)


def jacobian(scene: Scene, model: Model, base: Sequence[Array], only: Sequence[int] | None = None):
    """Columns d yhat / d theta, whitened, by one-sided differences; (N, p)."""
    theta = model.theta
    coordinates = model.coordinates
    wanted = range(len(theta)) if only is None else only

    def column(k: int) -> Array:
        c = coordinates[k]
        step = c.step
        if theta[k] + step > c.upper:
            step = -step
        moved = theta.copy()
        moved[k] += step
        residuals = scene.residuals(model.at(moved))
        if residuals is None:
            return np.zeros(scene.samples)
        return scene.whiten([(a - b) / step for a, b in zip(base, residuals, strict=True)])

    columns = list(_POOL.map(column, wanted))
    return np.column_stack(columns) if columns else np.zeros((scene.samples, 0))


def fit(scene: Scene, model: Model, *, rounds: int = 12, tolerance: float = 0.02) -> Fit:
    """Levenberg-Marquardt from `model`; stops where a step promises less than `tolerance` in the
    sum of squares (in units of the noise). Broyden's rank-one update spares differences while the
    steps do what they promise.
    """
    theta = model.theta
    residuals = scene.residuals(model)
    if residuals is None:
        white = np.full(scene.samples, np.sqrt(WORST / scene.samples))
        return Fit(model, white, np.zeros((scene.samples, len(theta))), "diverged")
    white = scene.whiten(residuals)
    if not len(theta):
        return Fit(model, white, np.zeros((len(white), 0)), "converged")
    j = jacobian(scene, model, residuals)
    fresh, damping, status = True, 1e-4, "rounds"
    lower = np.array([c.lower for c in model.coordinates])
    upper = np.array([c.upper for c in model.coordinates])
    for _ in range(rounds):
        step, promised = _step(j, white, damping, theta, lower, upper)
        if promised < tolerance:
            if fresh or promised < 0.1 * tolerance:
                status = "converged"
                break
            j, fresh = jacobian(scene, model, residuals), True
            continue
        trial_theta = np.clip(theta + step, lower, upper)
        candidate = model.at(trial_theta)
        tried = scene.residuals(candidate)
        cost = float(white @ white)
        if tried is not None:
            tried_white = scene.whiten(tried)
            gained = cost - float(tried_white @ tried_white)
        else:
            gained = -np.inf
        if gained > 0:
            moved = trial_theta - theta
            ratio = gained / promised
            change = white - tried_white - j @ moved
            size = np.linalg.norm(j, axis=0)
            weighted = moved * size**2
            theta, model, residuals, white = trial_theta, candidate, tried, tried_white
            damping *= 0.2 if ratio > 0.5 else 2.0
            if ratio > 0.7:
                j = j + np.outer(change, weighted / max(moved @ weighted, 1e-300))
                fresh = False
            elif gained > tolerance:
                j, fresh = jacobian(scene, model, residuals), True
        elif fresh:
            damping = max(damping * 10.0, 1e-3)
            if damping > 1e6:
                status = "stalled"
                break
        else:
            j, fresh = jacobian(scene, model, residuals), True
    return Fit(model, white, j, status)


def _step(j: Array, white: Array, damping: float, theta: Array, lower: Array, upper: Array):
    """The damped step within the bounds and the decrease the linear model promises for it."""
    scale = np.linalg.norm(j, axis=0)
    free = scale > 1e-10 * max(scale.max(), 1e-300)
    step = np.zeros(len(theta))
    for _ in range(3):
        index = np.flatnonzero(free)
        if not len(index):
            break
        q, r = np.linalg.qr(j[:, index] / scale[index])
        target = q.T @ (white - j @ np.where(free, 0.0, step))
        k = len(index)
        stacked = np.vstack([r, np.sqrt(damping) * np.eye(k)])
        solution = np.linalg.lstsq(stacked, np.append(target, np.zeros(k)), rcond=1e-12)[0]
        step[index] = solution / scale[index]
        out = free & ((theta + step < lower) | (theta + step > upper))
        if not out.any():
            break
        step[out] = np.clip(theta + step, lower, upper)[out] - theta[out]
        free = free & ~out
    left = white - j @ step
    return step, float(white @ white - left @ left)
