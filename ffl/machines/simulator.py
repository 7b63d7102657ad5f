"""A plant prepared for fast, deterministic closed-loop simulation with any set of effects."""

from __future__ import annotations

import copy
import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ffl.effects import Effect, Motion
from ffl.effects.mechanics import Mechanics
from ffl.effects.modal import is_speed, mechanics_of
from ffl.errors import InputError
from ffl.machines.kernel import run_loop
from ffl.machines.program import Compiler, Program, Side
from ffl.systems.loop import closed_loop
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array, StateSpace


@dataclass(frozen=True)
class Simulation:
    """Signals of one simulated run, each (N,): measured output `y`, command as sent `u`, noise-free
    position `x` and velocity `v` of the measured side; `contribution` (N, effects): what each effect
    adds at its port (mean force over the sample in input units, change of command, change of y;
    zero for effects of the linear part). `end` is the state after the last sample.

    Where the simulation diverged, the rest of the samples is NaN.
    """

    t: Array
    r: Array
    y: Array
    u: Array
    contribution: Array
    end: Array
    sides: dict[Side, int]
    positions: Array
    velocities: Array
    mass: float

    @property
    def x(self) -> Array:
        return self.positions[:, 0]

    @property
    def v(self) -> Array:
        return self.velocities[:, 0]

    @property
    def diverged(self) -> bool:
        return bool(np.isnan(self.y[-1])) if len(self.y) else False

    def motion(self, side: str = "sensor", mass_ratio: float | None = None) -> Motion:
        """Motion of a side that an effect acted on or that the run was told to watch."""
        if (side, mass_ratio) not in self.sides:
            raise InputError(
                f"motion of side '{side}' was not watched in this run; add it to watch"
            )
        k = self.sides[side, mass_ratio]
        v = np.ascontiguousarray(self.velocities[:, k])
        step = float(self.t[1] - self.t[0])
        a = np.gradient(v, step)
        return Motion(self.t, self.r, self.u, self.positions[:, k].copy(), v, a, step, self.mass)


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
        self.mechanics = mechanics_of(plant.system, is_speed(plant.output_unit))
        if open_loop or plant.controller is None:
            self.controller = StateSpace(
                np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[0.0, 0.0]],
                plant.sample_time,
            )  # fmt: skip
        else:
            closed_loop(plant.system, plant.controller)  # refuses an algebraic loop
            self.controller = plant.controller.state_space
        self._compiler = Compiler(plant, self.mechanics)

    def with_mechanics(self, mechanics: Mechanics) -> Simulator:
        """The same controller around another linear part that has the same states."""
        other = copy.copy(self)
        other.mechanics = mechanics
        other._compiler = Compiler(self.plant, mechanics)
        other.__dict__.pop("rest_unit", None)
        return other

    @property
    def n_plant(self) -> int:
        """Number of plant states at the front of `start`."""
        return self.mechanics.own + self.mechanics.fast.order

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
        m, n = self.mechanics, self.mechanics.own
        a, b, c = m.fast.a, m.fast.b, m.fast.c
        size = n + m.fast.order
        whole = scipy.linalg.block_diag(m.a[:n, :n], a - np.eye(m.fast.order))
        drive = np.concatenate([m.b[:n], b[:, 0]])
        sensed = np.concatenate([m.c[:n], c[0]])
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

    @functools.cached_property
    def rest_unit(self) -> Array:
        """`at_rest` at 1; of one position it is a multiple."""
        return self.at_rest(1.0)

    def prepare(
        self,
        effects: Sequence[EffectSpec],
        substeps: int | None = None,
        watch: Sequence[Side] = (),
    ) -> Program:
        """`effects` made ready once for many runs: 0.1 to 0.3 ms each time, a tenth to a half of a run."""
        return self._compiler.compile(effects, substeps, watch)

    def run(
        self,
        effects: Sequence[EffectSpec] | Program = (),
        reference: ArrayLike | None = None,
        feedforward: ArrayLike | None = None,
        *,
        force: ArrayLike | None = None,
        noise: ArrayLike | None = None,
        start: ArrayLike | None = None,
        start_time: float = 0.0,
        before: float = 0.0,
        travel: float = 0.0,
        place: float = 0.0,
        command_limit: float | None = None,
        encoder_resolution: float = 0.0,
        substeps: int | None = None,
        watch: Sequence[Side] = (),
        applied: tuple[ArrayLike, Side] | None = None,
        others: Sequence[tuple[Effect, EffectSpec]] = (),
    ) -> Simulation:
        """u = C_r r - C_y y + f, y = P (u + force), with `effects`, as such or as `prepare` made them
        ready (`substeps` and `watch` then count for nothing; nothing is `applied`, no `others`); open
        loop: u = f.

        `reference`, `feedforward`, `force` (beside u, in input units: known load, force noise) and
        `noise` (added to the measured y) are (N,) or None for zero. `applied` is a force (input
        units, straight between samples) and the side (name, mass_ratio) on which it acts; `watch`
        are sides whose motion is wanted. `before` is the command (input units) that was held until
        the first sample: what a delay or a lag of the command still remembers; `travel` the distance
        (output units, signed) covered in one direction until then: what a contact still remembers; `place`
        where a machine whose output is a speed begins (output units times s).
        `others`: effects of no catalogue, which act after those of the same port.
        Deterministic. Raises
        `InputError` for signals of unequal length and for effects that do not apply to the plant.
        """
        signals = _signals(reference, feedforward, force, noise, applied and applied[0])
        n = len(signals[0])
        if isinstance(effects, Program):
            if applied or others:
                raise InputError("simulate: a program made ready takes no further force or effect")
            program = effects
        else:
            wanted = [*watch, applied[1]] if applied else list(watch)
            program = self._compiler.compile(effects, substeps, wanted, bool(applied), others)
        delay = self.mechanics.delay
        if delay:  # the force enters with the command it stands beside
            signals[2] = np.concatenate([np.zeros(min(delay, n)), signals[2][: max(0, n - delay)]])
        state = self._split_state(start, program.mechanics, place)
        m, d = program.mechanics, program.discrete
        at_s, s = program.states(before, travel)
        positions, velocities = np.empty((2, n, len(d.rows_x)))
        out = (*np.empty((2, n)), positions, velocities, np.zeros((n, len(program.addresses))))
        run_loop(
            tuple(signals),
            (d.a, d.b, d.b_slope, m.c, m.d, d.bias, m.fast.a, m.fast.b[:, 0], m.fast.c[0],
             delay, d.step, d.substeps, float(start_time)),
            (d.rows_x, d.rows_v, d.e, d.e_slope, d.gx, d.gv, d.gx_slope, d.gv_slope),
            (self.controller.a, self.controller.b, self.controller.c, self.controller.d),
            (float(encoder_resolution), float(command_limit or np.inf)),
            (program.addresses, program.ports, program.where, program.remembers, program.at_p,
             at_s, program.p, s),
            state,
            out,
        )  # fmt: skip
        contribution = np.zeros((n, program.effects))
        for column, index in enumerate(program.index):
            contribution[:, index] += out[4][:, column]
        ring = np.roll(state[2], -(n % delay)) if delay else state[2]
        end = np.concatenate([state[0][: self.mechanics.own], state[1], ring, state[3]])
        t = start_time + self.plant.sample_time * np.arange(n)
        return Simulation(
            t, signals[0], out[0], out[1], contribution, end, program.sides, positions, velocities,
            m.moving_mass * self.force_per_input if m.modes else 0.0,
        )  # fmt: skip

    def substeps(self, effects: Sequence[EffectSpec]) -> int:
        """Sub-steps per sample that `run` would choose; hold it fixed while parameters are varied a
        little, or a step in it shows as a step in the result (of the size of the error, 1e-5)."""
        return self._compiler.compile(effects).discrete.substeps

    def respond(
        self, port: str, signal: ArrayLike, side: str = "sensor", mass_ratio: float | None = None
    ) -> Array:
        """Response of y to a signal that enters the linear loop at an effect's `port`, from rest.

        'force' in newton where the motor constant is known, at `side`; 'command' in input units;
        'output' in output units. One run per column for a signal of shape (N, k). With an effect's
        `regressors` this is its first-order contribution to y.
        """
        columns = np.asarray(signal, float)
        if columns.ndim == 2:
            each = [self.respond(port, column, side, mass_ratio) for column in columns.T]
            return np.column_stack(each) if each else columns
        if port == "command":
            return self.run((), force=columns).y
        if port == "output":
            return self.run((), noise=columns).y
        return self.run((), applied=(columns / self.force_per_input, (side, mass_ratio))).y

    def _split_state(
        self, start: ArrayLike | None, mechanics: Mechanics, place: float
    ) -> tuple[Array, Array, Array, Array]:
        vector = np.zeros(self.n_states) if start is None else np.array(start, float)
        if vector.shape != (self.n_states,):
            raise InputError(
                f"simulate: start has shape {vector.shape}, expected ({self.n_states},): plant, "
                "commands under way, controller"
            )
        n, own = self.mechanics.order, self.mechanics.own
        ring_at = self.n_plant
        controller_at = ring_at + self.mechanics.delay
        x = np.zeros(mechanics.order)
        x[:own] = vector[:own]
        x[own:n] = place  # of a speed the integral, else there is none
        if mechanics.order > n:
            x[n:] = mechanics.hung @ x[:n]
        ring, controller = vector[ring_at:controller_at], vector[controller_at:]
        return x, vector[own:ring_at].copy(), ring.copy(), controller.copy()


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


def _signals(*signals: ArrayLike | None) -> list[Array]:
    """Reference, feedforward, force, noise of one length, zero where absent; applied force as it is
    or of length 0."""
    lengths = {len(np.atleast_1d(s)) for s in signals if s is not None}
    if len(lengths) != 1:
        raise InputError(
            f"simulate: signals of lengths {sorted(lengths)}; give at least one signal, all of one "
            "length"
        )
    n = lengths.pop()
    reference, *three, applied = signals
    rows = [np.zeros(n) if reference is None else _as_row(reference)]  # a user's to keep
    rows += [_nothing(n) if s is None else _as_row(s) for s in three]
    return [*rows, _nothing(0) if applied is None else _as_row(applied)]


@functools.lru_cache(maxsize=16)
def _nothing(n: int) -> Array:
    """(n,) zeros that nobody writes to: the compiled loop reads its signals."""
    return np.zeros(n)


def _as_row(signal: ArrayLike) -> Array:
    """The signal itself where the compiled loop can read it as it is, else a copy that it can."""
    row = np.asarray(signal, float)
    return row if row.flags.c_contiguous and row.flags.writeable else np.array(row)
