"""Every number of an augmented plant refitted together: zeros, poles, gain and the effects' own.

A diagnosis names effects beside a linear model whose zeros stay where they are. To promise what a
feedforward will reach, the zeros matter too: where friction, cogging and the like have their names,
what is left between model and machine is linear.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffl.errors import InputError
from ffl.machines import Simulator, linear_part
from ffl.recordings import Recording
from ffl.systems import Plant, Zpk
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array
from ffl.systems.zpk import CIRCLE_TOLERANCE, as_zpk

GAIN, FREQUENCY, DAMPING, PHASE, LEVEL, PERIOD = 0.03, 0.05, 0.15, 1.0, 0.5, 0.02
DIFFERENCE = 1e-2  # of a standard deviation
LONGEST = 2.0  # standard deviations a step may go
PASSES, ROUNDS = 8, 6
ROUNDING = 1e-12  # of the range of y
BETTER = 0.9  # of the RMS left: what another pass must reach


@dataclass(frozen=True)
class Calibration:
    """`plant` refitted; `rms` of y - yhat (output units) before, after each pass; `changes` of each
    number in logarithms (phases: rad), by name."""

    plant: Plant
    rms: tuple[float, ...]
    changes: Mapping[str, float]


def calibrate(
    plant: Plant, recordings: Sequence[Recording], passes: int = PASSES, rounds: int = ROUNDS
) -> Calibration:
    """The plant whose free-running closed loop comes nearest to the recordings' y.

    Free are the gain of the slow end, every zero and pole (logarithms of frequency and damping ratio
    in continuous time; poles at 1 and roots at or left of 0 stay) and every number of the effects.
    Minimises |y - yhat|^2/s^2 + |changes/spread|^2 with the spreads an engineer's model has (gain
    3 %, frequencies 5 %, damping ratios 15 %, levels 50 %, periods 2 %, phases 1 rad), by Levenberg
    and Marquardt of at most `rounds` steps. s begins as large as what is left and follows it down, at
    most `passes` times: with it small from the start, the fit is caught where stick and slip come out
    in another order. With one pass the numbers stay near the model's, which is what an effect that is
    still missing needs.

    The recordings must begin at rest. The linear closed loop stays stable: what is learned next needs
    it, and friction that holds an unstable loop still is no explanation.
    Cost: some hundred simulations for every pass.
    """
    _check(plant, recordings)
    whole = _Numbers(plant)

    def left(x: Array, stable: bool = True) -> Array:
        try:
            plant = whole.plant(x)
            if stable:
                linear_part(plant).require_stable()
            return free_running(plant, recordings)
        except (InputError, np.linalg.LinAlgError):  # numbers that no plant or effect can have
            return np.full(sum(len(r) for r in recordings), np.inf)

    linear_part(plant).require_stable()
    x = np.zeros(len(whole.names))
    rms = [_rms(left(x))]
    if not np.isfinite(rms[0]):
        raise InputError(f"calibrate: plant '{plant.name}' diverges on these recordings")
    least = ROUNDING * max(float(np.ptp(r.y)) for r in recordings)
    for _ in range(passes):
        if rms[-1] <= least:
            break
        x = _descend(left, x, rms[-1], rounds)
        rms.append(_rms(left(x)))
        if rms[-1] > BETTER * rms[-2]:
            break
    changes = dict(zip(whole.names, (x * whole.spread).tolist(), strict=True))
    return Calibration(whole.plant(x), tuple(rms), changes)


def _check(plant: Plant, recordings: Sequence[Recording]) -> None:
    if not recordings:
        raise InputError("calibrate: no recording given; give at least one")
    if plant.controller is None:
        raise InputError(
            f"calibrate: plant '{plant.name}' has no [controller]; it is needed to run the loop"
        )
    for r in recordings:
        if abs(r.sample_time / plant.sample_time - 1.0) > 1e-3:
            raise InputError(
                f"{r.source}: sample time {r.sample_time:g} s, plant '{plant.name}' has "
                f"{plant.sample_time:g} s; resample one of them"
            )


def free_running(plant: Plant, recordings: Sequence[Recording]) -> Array:
    """y - yhat of all recordings in a row, from rest; infinite where the simulation diverges."""
    simulator = Simulator(plant)
    out = []
    for r in recordings:
        run = simulator.run(
            plant.effects,
            r.r,
            r.f,
            force=r.d,
            start=simulator.at_rest(float(r.r[0])),
            command_limit=plant.machine.command_limit,
        )
        out.append(np.nan_to_num(r.y - run.y, nan=np.inf))
    return np.concatenate(out)


def _rms(e: Array) -> float:
    return float(np.sqrt(np.mean(e**2)))


def _descend(left: Callable[..., Array], x: Array, scale: float, rounds: int) -> Array:
    """Levenberg-Marquardt on left(x)/scale with x itself as prior."""
    white = left(x) / scale
    cost, damping = float(white @ white + x @ x), 1e-3
    n = len(x)
    for _ in range(rounds):
        j = _jacobian(left, x, scale, white)
        q, r = np.linalg.qr(j)
        size = np.sqrt(np.sum(r**2, axis=0) + 1.0)
        moved = None
        while damping < 1e8:
            rows = np.vstack([r, np.eye(n), np.sqrt(damping) * np.diag(size)])
            right = np.concatenate([-q.T @ white, -x, np.zeros(n)])
            step = np.clip(np.linalg.lstsq(rows, right, rcond=None)[0], -LONGEST, LONGEST)
            tried = left(x + step) / scale
            now = float(tried @ tried + (x + step) @ (x + step))
            if now < cost:
                moved = x + step
                break
            damping = max(5.0 * damping, 1e-4)
        if moved is None:
            break
        gained = 1.0 - now / cost
        x, white, cost, damping = moved, tried, now, damping / 8.0
        if gained < 0.01:
            break
    return x


def _jacobian(left: Callable[..., Array], x: Array, scale: float, white: Array) -> Array:
    steps = x + DIFFERENCE * np.eye(len(x))
    columns = [(left(step, stable=False) / scale - white) / DIFFERENCE for step in steps]
    return np.column_stack([c if np.all(np.isfinite(c)) else np.zeros_like(c) for c in columns])


@dataclass(frozen=True)
class Freedom:
    """What every number that `calibrate` moves could still take off the free-running `error` (stacked
    over the recordings, output units), held back by its spread."""

    error: Array
    scale: float
    basis: Array

    @classmethod
    def of(cls, plant: Plant, recordings: Sequence[Recording]) -> Freedom:
        whole = _Numbers(plant)

        def left(x: Array, stable: bool = False) -> Array:
            return free_running(whole.plant(x), recordings)

        x = np.zeros(len(whole.names))
        error = left(x)
        scale = max(_rms(error), 1e-300)
        j = _jacobian(left, x, scale, error / scale)
        return cls(error, scale, np.linalg.qr(np.vstack([j, np.eye(len(x))]))[0])

    def beyond(self, columns: Array) -> Array:
        """Columns (N,) or (N, k) over the scale, beyond that freedom; rows of the spreads added."""
        rows = np.zeros((len(self.basis) - len(self.error), *columns.shape[1:]))
        whole = np.concatenate([columns / self.scale, rows])
        return whole - self.basis @ (self.basis.T @ whole)


class _Numbers:
    """A plant as a vector of changes in units of their spreads, zero at nominal."""

    def __init__(self, plant: Plant) -> None:
        self._plant, self._zpk = plant, as_zpk(plant.system)
        self._roots = [_Roots("zero", self._zpk.zeros), _Roots("pole", self._zpk.poles)]
        self._numbers = list(_numbers(plant.effects))
        self._last: tuple[list[float], Zpk] | None = None
        names, spread = ["gain"], [GAIN]
        for roots in self._roots:
            names += roots.names
            spread += roots.spread
        for index, key, width in self._numbers:
            names.append(f"{plant.effects[index].name}.{key}")
            spread.append(width)
        self.names, self.spread = names, np.array(spread)

    def plant(self, x: Array) -> Plant:
        changes = (x * self.spread).tolist()
        count = len(changes) - len(self._numbers)
        if self._last is None or self._last[0] != changes[:count]:
            self._last = changes[:count], self._system(iter(changes[:count]))
        parameters = [dict(e.parameters) for e in self._plant.effects]
        for (index, key, _), change in zip(self._numbers, changes[count:], strict=True):
            parameters[index][key] = _changed(key, parameters[index][key], change)
        effects = tuple(
            EffectSpec(e.name, p, e.options)
            for e, p in zip(self._plant.effects, parameters, strict=True)
        )
        return replace(self._plant, system=self._last[1], effects=effects)

    def _system(self, changes: Iterator[float]) -> Zpk:
        gain = self._zpk.gain * float(np.exp(next(changes)))
        zeros, poles = (roots.moved(changes) for roots in self._roots)
        # The change of gain is one of the slow end: moved roots alone must not change it.
        gain *= _slow(self._zpk.zeros, self._zpk.poles) / _slow(zeros, poles)
        z = self._zpk
        return Zpk(zeros, poles, gain, z.sample_time, z.delay)


def _numbers(effects: Sequence[EffectSpec]) -> Iterator[tuple[int, str, float]]:
    for index, effect in enumerate(effects):
        for key, value in effect.parameters.items():
            if isinstance(value, int | float) and (value or key.startswith("phase")):
                phase, period = key.startswith("phase"), key == "period"
                yield index, key, PHASE if phase else PERIOD if period else LEVEL


def _changed(key: str, value: float, change: float) -> float:
    return value + change if key.startswith("phase") else value * float(np.exp(change))


def _slow(zeros: Array, poles: Array) -> float:
    """prod |1 - z|/prod |1 - p| over the roots that are not 1: the gain near z = 1."""
    parts = [np.abs(1.0 - np.asarray(r)) for r in (zeros, poles)]
    top, bottom = (p[p > CIRCLE_TOLERANCE] for p in parts)
    return float(np.prod(top) / np.prod(bottom))


class _Roots:
    """Roots in the z plane, moved along frequency and damping of log z."""

    def __init__(self, kind: str, roots: Array) -> None:
        z = np.asarray(roots, complex)
        real = np.abs(z.imag) < 1e-12
        fixed = real & ((z.real <= 0) | (np.abs(z - 1.0) <= CIRCLE_TOLERANCE))
        self._fixed, self._real = z[fixed], z[real & ~fixed].real
        self._pairs = z[~real & (z.imag > 0)]
        self.names = [f"{kind} {r:.5g}" for r in self._real]
        self.spread = [2 * FREQUENCY if kind == "pole" else FREQUENCY] * len(self._real)
        for c in self._pairs:
            self.names += [f"{kind} {c:.5g} frequency", f"{kind} {c:.5g} damping"]
            self.spread += [FREQUENCY, DAMPING]

    def moved(self, changes: Iterator[float]) -> Array:
        out = list(self._fixed)
        out += [np.exp(np.log(r) * np.exp(next(changes))) for r in self._real]
        for c in self._pairs:
            s = np.log(c)
            w, damping = abs(s) * np.exp(next(changes)), -s.real / abs(s) * np.exp(next(changes))
            root = np.exp(w * (-damping + 1j * np.sqrt(max(1.0 - damping**2, 1e-9))))
            out += [root, root.conjugate()]
        return np.array(out)
