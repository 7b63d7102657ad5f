"""How a signal gets from where it acts to the whitened y: impulse responses of the linear loop, and
what a sensor shows of what they bring."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.fft

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.linear import discrete
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.recorded.first_state import shown_in, start_behind
from ffl.effects.mechanics import Mechanics
from ffl.systems.loop import Controller, closed_loop
from ffl.systems.state_space import Array, StateSpace

TAIL = 1e-7  # energy of an impulse response that may be cut off
RUNS_AWAY = 1.0 + 1e-9  # of a pole
STANDING = 1e-14  # of what a sensor adds: a loop takes all of what stays out again


class Passage:
    """From every place to the whitened y of the recordings of `scene`, to first order beside `model`."""

    def __init__(self, scene: Scene, model: Model) -> None:
        self.scene, self.model = scene, model
        self._impulses: dict[Place, list[Array]] = {}
        self._spectra: dict[Place, list[tuple[int, Array]]] = {}
        self._starts: dict[int, Array] = {}

    def of(self, scene: Scene) -> Passage:
        """The same for a scene of the same noise and loop, whose recordings began otherwise."""
        other = copy.copy(self)
        other.scene = scene
        return other

    def through(
        self, place: Place, columns: Sequence[Array], passed: Sequence[Array] | None = None
    ) -> Array:
        """Regressors of each recording (N_i, k) filtered to whitened y and stacked; of a sensor in a
        loop at rest what changes since: the loop has brought the rest to the reference; in motion the
        plant begins where the sensor shows what it showed (lags in a row forget it). `passed` (N_i,): what
        the sensor shows of a small change; all of it where there is none."""
        out = []
        settled = place.port == "output" and self.scene.loop.controller is not None
        for k, (x, trial) in enumerate(zip(columns, self.scene.trials, strict=True)):
            x = x - x[0] if settled and trial.at_rest else x
            if passed is None:
                n, response = self._responses(place)[k]
                y = scipy.fft.irfft(scipy.fft.rfft(x.T, n) * response, n)[:, : len(x)].T
            else:
                seen = passed[k][:, None] * self._moved(place, x)
                y = self.scene.whiteners[k].steady(seen)
            if place.port == "output" and self.model.base.keeps_start(trial):
                y = y + self._begun(k) @ self._behind(x)
            out.append(trial.weighed(y))
        return np.concatenate(out)

    def _behind(self, x: Array) -> Array:
        """Where the loop begins for a sensor that adds the signals x (N, k): its states, (n, k)."""
        simulator = self.model.simulator
        return start_behind(simulator, x[: shown_in(simulator, len(x))])

    def _begun(self, index: int) -> Array:
        """Whitened y, (N, n), of the loop that begins with one in each of its states."""
        if index not in self._starts:
            simulator, still = self.model.simulator, np.zeros(len(self.scene.trials[index]))
            y = [simulator.run((), still, start=unit).y for unit in np.eye(simulator.n_states)]
            self._starts[index] = self.scene.whiteners[index].steady(np.column_stack(y))
        return self._starts[index]

    def _moved(self, place: Place, x: Array) -> Array:
        """What signals x (N, k) at `place` do to y before its sensor."""
        response = self._response(place)
        n = scipy.fft.next_fast_len(len(x) + len(response) - 1, real=True)
        return scipy.fft.irfft(scipy.fft.rfft(x.T, n) * scipy.fft.rfft(response, n), n)[
            :, : len(x)
        ].T

    def impulses(self, place: Place) -> list[Array]:
        """Impulse response from a signal at `place` to the whitened y, one per recording."""
        if place not in self._impulses:
            response = self._response(place)
            out = []
            done: dict[int, Array] = {}
            for whitener in self.scene.whiteners:
                key = id(whitener)
                if key not in done:
                    h = whitener.steady(response)
                    energy = np.cumsum(h[::-1] ** 2)[::-1]
                    tail = STANDING if place.port == "output" else TAIL
                    keep = int(np.searchsorted(-energy, -tail * energy[0])) + 1
                    done[key] = h[:keep]
                out.append(done[key])
            self._impulses[place] = out
        return self._impulses[place]

    def _response(self, place: Place) -> Array:
        """Impulse response from a signal at `place` to y."""
        longest = max(len(t) for t in self.scene.trials)
        n = min(longest, 1 << 14)
        mechanics = self.model.simulator.mechanics
        loop = self.scene.loop
        unit = np.zeros(n)
        unit[0] = 1.0
        if place.port == "output":
            return loop.sensitivity.filter(unit)
        if place.port == "command":
            return loop.process_sensitivity.filter(unit)
        point = mechanics.point(place.side, place.mass_ratio)
        through = replace(mechanics, b=point.force, d=0.0, delay=0, exact=None)
        alone = discrete(replace(through, fast=nothing(mechanics.sample_time)))
        if (np.abs(loop.plant.poles) > RUNS_AWAY).any():
            return _held(mechanics, alone.b, loop.controller).filter(unit)
        return loop.sensitivity.filter(alone.filter(unit))

    def _responses(self, place: Place) -> list[tuple[int, Array]]:
        """Length of the transform and spectrum of the impulse response, one per recording."""
        if place not in self._spectra:
            out = []
            for trial, h in zip(self.scene.trials, self.impulses(place), strict=True):
                n = scipy.fft.next_fast_len(len(trial) + len(h) - 1, real=True)
                out.append((n, scipy.fft.rfft(h, n)))
            self._spectra[place] = out
        return self._spectra[place]


def _held(mechanics: Mechanics, push: Array, controller: Controller | None) -> StateSpace:
    """From a force, which does `push` (k, 1) to the plant's own states in a sample, to y, in the loop that
    holds the plant: apart from it the answer of an unstable plant has no end (a sine of 18 times the noise
    at a magnetic bearing was not seen, its column 1e114 long)."""
    system = closed_loop(discrete(replace(mechanics, exact=None)), controller).system
    b, line = np.zeros((system.order, 1)), mechanics.delay  # the states that hold the command up
    b[line : line + len(push)] = push
    return StateSpace(system.a, b, system.c[:1], 0.0, system.sample_time)


def nothing(sample_time: float) -> StateSpace:
    return StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), 0.0, sample_time)
