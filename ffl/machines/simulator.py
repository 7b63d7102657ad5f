"""A plant prepared for fast, deterministic closed-loop simulation with any set of effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ffl.effects import Effect, Setting, effect_of
from ffl.effects.base import Law
from ffl.effects.law import address_of
from ffl.effects.mechanics import Mechanics, Point
from ffl.effects.modal import mechanics_of
from ffl.errors import InputError
from ffl.machines.kernel import PORTS, run_loop
from ffl.systems.loop import closed_loop
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array, StateSpace

STEP_ANGLE = 0.3  # a sub-step is short enough for the stiffest effect to turn by less (rad)
MOST_SUBSTEPS = 64


@dataclass(frozen=True)
class Simulation:
    """Signals of one simulated run, each (N,): measured output `y`, command as sent `u`, noise-free
    position `x` and velocity `v` of the measured side; `contribution` (N, effects): what each effect
    adds at its port (mean force over the sample in input units, change of command, change of y;
    zero for effects of the linear part). `end` is the state after the last sample.

    Where the simulation diverged, the rest of the samples is NaN.
    """

    y: Array
    u: Array
    x: Array
    v: Array
    contribution: Array
    end: Array

    @property
    def diverged(self) -> bool:
        return bool(np.isnan(self.y[-1])) if len(self.y) else False


class Simulator:
    """Simulates one plant with its controller; build once, run thousands of times.

    `effects` are arguments of every run, so their parameters can be fitted; building the discrete
    matrices for a set of points is cached, and effects of the linear part (mass, damping, stiffness,
    mode) cost one matrix exponential per run.

    The state of a run, `start` and `Simulation.end`, is one vector: states of the plant, commands
    still under way (`delay` of them), states of the controller (none in open loop). For a plant
    without pure delay these are the states of its and of the controller's state space.
    """

    def __init__(self, plant: Plant, open_loop: bool = False) -> None:
        self.plant = plant
        self.mechanics = mechanics_of(plant.system)
        if open_loop or plant.controller is None:
            self.controller = StateSpace(
                np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[0.0, 0.0]],
                plant.sample_time,
            )  # fmt: skip
        else:
            closed_loop(plant.system, plant.controller)  # refuses an algebraic loop
            self.controller = plant.controller.state_space
        self._prepared: dict[tuple[object, ...], _Discrete] = {}

    @property
    def n_plant(self) -> int:
        """Number of plant states at the front of `start`."""
        return self.mechanics.order + self.mechanics.fast.order

    @property
    def n_states(self) -> int:
        """Length of `start`."""
        return self.n_plant + self.mechanics.delay + self.controller.order

    @property
    def force_per_input(self) -> float:
        """Newton per input unit, 1 where it is unknown (forces are then in the input's unit)."""
        return self.plant.physics.motor_constant or 1.0

    def at_rest(self, position: float) -> Array:
        """The state of a machine that stands still at `position` with r = y = position.

        Where standing still needs a command (a plant with stiffness), the controller's state is the
        one of least size that gives it.
        """
        m, n = self.mechanics, self.mechanics.order
        a, b, c = m.fast.a, m.fast.b, m.fast.c
        size = n + m.fast.order
        whole = scipy.linalg.block_diag(m.a, a - np.eye(m.fast.order))
        drive = np.concatenate([m.b, b[:, 0]])
        sensed = np.concatenate([m.c, c[0]])
        system = np.block([[whole, drive[:, None]], [sensed[None], np.array([[m.d]])]])
        wanted = np.append(np.zeros(size), position)
        scale = np.abs(system).max(axis=1, keepdims=True)
        scale[scale == 0] = 1.0
        solution = np.linalg.lstsq(system / scale, wanted / scale[:, 0], rcond=1e-13)[0]
        command = float(solution[size])
        k = self.controller
        inputs = np.full(2, position)
        rows = np.vstack([k.a - np.eye(k.order), k.c])
        target = np.append(-k.b @ inputs, command - float((k.d @ inputs)[0]))
        states = np.linalg.lstsq(rows, target, rcond=None)[0]
        return np.concatenate([solution[:size], np.full(m.delay, command), states])

    def run(
        self,
        effects: Sequence[EffectSpec] = (),
        reference: ArrayLike | None = None,
        feedforward: ArrayLike | None = None,
        *,
        force: ArrayLike | None = None,
        noise: ArrayLike | None = None,
        start: ArrayLike | None = None,
        start_time: float = 0.0,
        command_limit: float | None = None,
        encoder_resolution: float = 0.0,
        substeps: int | None = None,
    ) -> Simulation:
        """u = C_r r - C_y y + f, y = P (u + force), with `effects`; open loop: u = f.

        `reference`, `feedforward`, `force` (beside u, in input units: known load, force noise) and
        `noise` (added to the measured y) are (N,) or None for zero. Deterministic. Raises
        `InputError` for signals of unequal length and for effects that do not apply to the plant.
        """
        lengths = {
            len(np.atleast_1d(s)) for s in (reference, feedforward, force, noise) if s is not None
        }
        if len(lengths) != 1:
            raise InputError(
                f"simulate: signals of lengths {sorted(lengths)}; give at least one signal, all of "
                "one length"
            )
        n = lengths.pop()
        signals = np.zeros((4, n))
        for row, signal in zip(signals, (reference, feedforward, force, noise), strict=True):
            if signal is not None:
                row[:] = signal
        program = self._program(effects, substeps)
        delay = self.mechanics.delay
        if delay and force is not None:  # the force enters with the command it stands beside
            signals[2] = np.concatenate([np.zeros(min(delay, n)), signals[2][: max(0, n - delay)]])
        state = self._split_state(start, program.mechanics)
        out = (*np.empty((4, n)), np.zeros((n, len(program.addresses))))
        m = program.mechanics
        d = program.discrete
        run_loop(
            signals,
            (d.a, d.b, d.b_slope, m.c, m.d, d.bias, m.fast.a, m.fast.b[:, 0], m.fast.c[0],
             delay, d.step, d.substeps, float(start_time)),
            (d.rows_x, d.rows_v, d.e, d.e_slope, d.gx, d.gv, d.gx_slope, d.gv_slope),
            (self.controller.a, self.controller.b, self.controller.c, self.controller.d),
            (float(encoder_resolution), float(command_limit or np.inf)),
            (program.addresses, program.ports, program.where, program.remembers,
             program.at_p, program.at_s,
             program.p, program.s.copy()),
            state,
            out,
        )  # fmt: skip
        contribution = np.zeros((n, len(effects)))
        contribution[:, program.index] = out[4]
        ring = np.roll(state[2], -(n % delay)) if delay else state[2]
        end = np.concatenate([state[0][: self.mechanics.order], state[1], ring, state[3]])
        return Simulation(out[0], out[1], out[2], out[3], contribution, end)

    def _split_state(
        self, start: ArrayLike | None, mechanics: Mechanics
    ) -> tuple[Array, Array, Array, Array]:
        vector = np.zeros(self.n_states) if start is None else np.array(start, float)
        if vector.shape != (self.n_states,):
            raise InputError(
                f"simulate: start has shape {vector.shape}, expected ({self.n_states},): plant, "
                "commands under way, controller"
            )
        n, cuts = self.mechanics.order, np.cumsum([self.mechanics.order, self.mechanics.fast.order])
        cuts = np.append(cuts, cuts[-1] + self.mechanics.delay)
        x, fast, ring, controller = np.split(vector, cuts)
        x = np.concatenate([x, mechanics.hung @ x]) if mechanics.order > n else x
        return x.copy(), fast.copy(), ring.copy(), controller.copy()

    def _program(self, effects: Sequence[EffectSpec], substeps: int | None) -> _Program:
        catalogue = [effect_of(spec) for spec in effects]
        checked = [effect.check(spec) for effect, spec in zip(catalogue, effects, strict=True)]
        mechanics, changes = self.mechanics, []
        for effect, spec, values in zip(catalogue, effects, checked, strict=True):
            changed = effect.modify(mechanics, values, self._setting(mechanics, spec))
            if changed is not mechanics:
                mechanics = changed
                changes.append((spec.name, repr(values), repr(spec.options)))
        sides: dict[tuple[str, float | None], int] = {("sensor", None): 0}
        actors: list[_Actor] = []
        for index, (effect, spec, values) in enumerate(
            zip(catalogue, effects, checked, strict=True)
        ):
            setting = self._setting(mechanics, spec)
            law = effect.law_in(setting)
            if law is None:
                continue
            key = (effect.side_in(setting), setting.mass_ratio)
            where = sides.setdefault(key, len(sides))
            packed = effect.pack(values, setting)
            actors.append(_Actor(index, effect, effect.port_in(setting), where, law, packed))
        points = [mechanics.point(*key) for key in sides]
        if substeps is None:
            substeps = self._substeps(actors, points)
        key_of_all = (*changes, *sides, substeps)
        discrete = self._prepared.get(key_of_all)
        if discrete is None:
            discrete = _discretise(mechanics, points, substeps)
            if not changes:
                self._prepared[key_of_all] = discrete
        states = [actor.effect.initial_state(actor.packed, discrete.step) for actor in actors]
        return _Program(
            mechanics,
            discrete,
            np.array([actor.index for actor in actors], np.int64),
            np.array([address_of(actor.law) for actor in actors], np.int64),
            np.array([PORTS[actor.port] for actor in actors], np.int64),
            np.array([actor.where for actor in actors], np.int64),
            np.array([actor.effect.remembers for actor in actors], np.bool_),
            _offsets([actor.packed for actor in actors]),
            _offsets(states),
            np.array([value for actor in actors for value in actor.packed] or [0.0]),
            np.array([value for values in states for value in values] or [0.0]),
        )

    def _setting(self, mechanics: Mechanics, spec: EffectSpec) -> Setting:
        return Setting(self.force_per_input, mechanics, spec.options)

    def _substeps(self, actors: Sequence[_Actor], points: Sequence[Point]) -> int:
        """Sub-steps of a sample in which the stiffest force turns by at most STEP_ANGLE."""
        stiffest = 0.0
        for actor in actors:
            if actor.port == "force":
                mobility = points[actor.where].mobility
                self._require_mobility(mobility, actor.effect.name)
                stiffest = max(stiffest, actor.effect.stiffness(actor.packed) * mobility)
        angle = np.sqrt(stiffest) * self.plant.sample_time
        return int(np.clip(np.ceil(angle / STEP_ANGLE), 1, MOST_SUBSTEPS))

    def _require_mobility(self, mobility: float, name: str) -> None:
        if not mobility > 0:
            raise InputError(
                f"effect {name}: plant {self.plant.name} has no moving mass at that point (its output "
                "is not the position of a driven mass there); choose another side, or an effect on "
                "the command or the sensor"
            )


def simulate(
    plant: Plant,
    effects: Sequence[EffectSpec],
    reference: ArrayLike,
    feedforward: ArrayLike | None = None,
    load: ArrayLike | None = None,
    force: ArrayLike | None = None,
    start: ArrayLike | None = None,
    noise: ArrayLike | None = None,
) -> Simulation:
    """One deterministic run of `plant` with `effects`; see `Simulator.run` (build a `Simulator` once
    where many runs of one plant are needed). `load` and `force` both act beside u, in input units."""
    beside = [np.asarray(s, float) for s in (load, force) if s is not None]
    total = sum(beside) if beside else None
    return Simulator(plant).run(
        effects, reference, feedforward, force=total, noise=noise, start=start
    )


@dataclass(frozen=True)
class _Discrete:
    """Matrices of one sub-step; `_slope` is the response to the line 2 s/h - 1."""

    a: Array
    b: Array
    b_slope: Array
    bias: Array
    rows_x: Array
    rows_v: Array
    e: Array
    e_slope: Array
    gx: Array
    gv: Array
    gx_slope: Array
    gv_slope: Array
    step: float
    substeps: int


@dataclass(frozen=True)
class _Actor:
    """An effect that acts in the kernel."""

    index: int
    effect: Effect
    port: str
    where: int
    law: Law
    packed: list[float]


@dataclass(frozen=True)
class _Program:
    mechanics: Mechanics
    discrete: _Discrete
    index: Array
    addresses: Array
    ports: Array
    where: Array
    remembers: Array
    at_p: Array
    at_s: Array
    p: Array
    s: Array


def _offsets(parts: Sequence[Sequence[float]]) -> Array:
    return np.cumsum([0, *[len(part) for part in parts[:-1]]]).astype(np.int64)[: len(parts)]


def _discretise(m: Mechanics, points: Sequence[Point], substeps: int) -> _Discrete:
    """exp of [[A, B, 0], [0, 0, I/h], [0, 0, 0]] h: responses to constant and to straight inputs."""
    n, h = m.order, m.sample_time / substeps
    inputs = np.column_stack([m.b, *[p.force for p in points], *[p.force for p, _ in m.bias]])
    k = inputs.shape[1]
    block = np.zeros((n + 2 * k, n + 2 * k))
    block[:n, :n], block[:n, n : n + k] = m.a * h, inputs * h
    block[n : n + k, n + k :] = np.eye(k)
    exponential = scipy.linalg.expm(block)
    a, level = exponential[:n, :n], exponential[:n, n : n + k]
    slope = 2.0 * exponential[:n, n + k :] - level  # the ramp s/h enters as its own integral
    if m.exact is not None and substeps == 1:
        a, level = m.exact.a, np.column_stack([m.exact.b[:, 0], level[:, 1:]])
    count = len(points)
    forces, bias = level[:, 1 : 1 + count], level[:, 1 + count :]
    e_slope = slope[:, 1 : 1 + count]
    rows_x = np.array([p.position for p in points]).reshape(count, n)
    rows_v = np.array([p.velocity for p in points]).reshape(count, n)
    constant = bias @ np.array([f for _, f in m.bias]) if m.bias else np.zeros(n)
    pieces = (
        a, level[:, 0], slope[:, 0], constant, rows_x, rows_v, forces, e_slope,
        rows_x @ forces, rows_v @ forces, rows_x @ e_slope, rows_v @ e_slope,
    )  # fmt: skip
    return _Discrete(*(np.ascontiguousarray(piece) for piece in pieces), h, substeps)
