"""From a set of effects to what the kernel runs: laws, parameters, states, sub-step matrices."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffl.effects import Effect, Setting, effect_of
from ffl.effects.base import Law
from ffl.effects.law import IO_SIZE, MEAN, SLOPE, address_of
from ffl.effects.leading import leading
from ffl.effects.linear_mechanics import in_turn
from ffl.effects.mechanics import Mechanics
from ffl.effects.point import Point
from ffl.errors import InputError
from ffl.machines.exponential import exponential
from ffl.machines.kernel import PORTS
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

STEP_ANGLE = 0.3  # a sub-step is short enough for the stiffest effect to turn by less (rad)
MODE_ANGLE = 0.4  # the same for the first mode, where dry friction excites it
FALL = 0.15  # and for friction that falls with speed to change the velocity by this share of it
MOST_FALL_STEPS = 8
MOST_SUBSTEPS = 64
SAME = 1e-9  # of the largest number of a point, and of each: nearer than this two points are one
TIME = frozenset({"time", "temperature"})  # what goes on whatever the machine does

Side = tuple[str, float | None]


class Compiler:
    """Compiles effects for one plant; matrices of unchanged linear parts are kept."""

    def __init__(self, plant: Plant, mechanics: Mechanics) -> None:
        self._plant = plant
        self._mechanics = mechanics
        self._force_per_input = plant.physics.motor_constant or 1.0
        self._prepared: dict[tuple[object, ...], Discrete] = {}
        self._points: dict[Side, Point] = {}

    def compile(
        self,
        effects: Sequence[EffectSpec],
        substeps: int | None = None,
        watch: Sequence[Side] = (),
        last: bool = False,
        others: Sequence[tuple[Effect, EffectSpec]] = (),
    ) -> Program:
        """Everything the kernel needs; with `last`, the last watched side gets a point at the end;
        `others`: see `Simulator.run`."""
        catalogue = [*(effect_of(spec) for spec in effects), *(effect for effect, _ in others)]
        effects = [*effects, *(spec for _, spec in others)]
        checked = [effect.check(spec) for effect, spec in zip(catalogue, effects, strict=True)]
        mechanics, changes = self._mechanics, []
        for k in in_turn(catalogue, effects):
            effect, spec, values = catalogue[k], effects[k], checked[k]
            changed = effect.modify(mechanics, values, self._setting(mechanics, spec))
            if changed is not mechanics:
                mechanics = changed
                changes.append((spec.name, repr(values), repr(spec.options)))
        points = Points(mechanics, self._points if mechanics is self._mechanics else {})
        points.place(("sensor", None))
        actors: list[_Actor] = []
        for index, (effect, spec, values) in enumerate(
            zip(catalogue, effects, checked, strict=True)
        ):
            setting = self._setting(mechanics, spec)
            port = effect.port_in(setting)
            for part in effect.parts(values, setting):
                where = points.place((part.side, part.mass_ratio))
                actors.append(_Actor(index, effect, port, where, part.law, part.packed))
        # Forces that no motion changes come first: those that it does are then solved beside them once.
        actors.sort(
            key=lambda a: a.port == "force" and set(a.effect.depends_on) <= TIME, reverse=True
        )
        actors.sort(key=lambda actor: actor.effect.order(checked[actor.index]))
        bent = [actor for actor in actors if actor.effect.bends]
        bent = bent[: leading((actor.effect, checked[actor.index]) for actor in actors)]
        actors = [*bent, *(actor for actor in actors if actor not in bent)]
        for side in watch:
            points.place(side)
        if last:
            points.append(watch[-1])
        needed = self._substeps(actors, points.found)
        substeps = needed if substeps is None else substeps
        key = (*changes, *points.kept, substeps)
        discrete = self._prepared.get(key)
        if discrete is None:
            discrete = _discretise(mechanics, points.found, substeps)
            if not changes:
                self._prepared[key] = discrete
        return Program(
            mechanics,
            discrete,
            points.index,
            len(effects),
            tuple(actors),
            np.array([actor.index for actor in actors], np.int64),
            np.array([address_of(actor.law) for actor in actors], np.int64),
            np.array([PORTS[actor.port] for actor in actors], np.int64),
            np.array([actor.where for actor in actors], np.int64),
            np.array([actor.effect.remembers for actor in actors], np.bool_),
            *_packed([actor.packed for actor in actors]),
        )

    def _setting(self, mechanics: Mechanics, spec: EffectSpec) -> Setting:
        return Setting(self._force_per_input, mechanics, spec.options)

    def _substeps(self, actors: Sequence[_Actor], points: Sequence[Point]) -> int:
        """Sub-steps of a sample, short enough for the stiffest force and for friction on a mode."""
        stiffest, weakest = 0.0, 0.0
        for actor in actors:
            if actor.port != "force":
                continue
            mobility = points[actor.where].mobility
            if actor.effect.needs_mass and not mobility > 0:
                raise InputError(
                    f"effect {actor.effect.name}: plant {self._plant.name} has no moving mass at that "
                    "point (its output is not the position of a driven mass there); choose another "
                    "side, or an effect on the command or the sensor"
                )
            stiffest = max(stiffest, actor.effect.stiffness(actor.packed) * max(mobility, 0.0))
            weakest = max(weakest, actor.effect.weakening(actor.packed) * max(mobility, 0.0))
        angle = np.sqrt(stiffest) / STEP_ANGLE
        modes = self._mechanics.modes
        if len(modes) > 1 and any(actor.effect.switches for actor in actors):
            angle = max(angle, np.sqrt(abs(modes[1].stiffness)) / MODE_ANGLE)
        steps = np.ceil(angle * self._plant.sample_time)
        falls = np.ceil(weakest * self._plant.sample_time / FALL)
        return int(np.clip(max(steps, min(falls, MOST_FALL_STEPS)), 1, MOST_SUBSTEPS))


class Points:
    """The points that a set of effects needs; sides that are one and the same place share one."""

    def __init__(self, mechanics: Mechanics, known: dict[Side, Point]) -> None:
        self._mechanics, self._known = mechanics, known
        self.found: list[Point] = []
        self.kept: list[Side] = []
        self.index: dict[Side, int] = {}

    def place(self, side: Side) -> int:
        """Index of the point of `side`."""
        if side not in self.index:
            point = self._point(side)
            for k, known in enumerate(self.found):
                if _same(point, known):
                    self.index[side] = k
                    return k
            self.append(side)
        return self.index[side]

    def append(self, side: Side) -> None:
        """A point of its own for `side`, at the end."""
        self.index.setdefault(side, len(self.found))
        self.found.append(self._point(side))
        self.kept.append(side)

    def _point(self, side: Side) -> Point:
        if side not in self._known:
            self._known[side] = self._mechanics.point(*side)
        return self._known[side]


def _same(one: Point, other: Point) -> bool:
    return one is other or all(
        np.all(np.abs(a - b) <= SAME * np.abs(b).max(initial=0.0) + SAME * np.abs(b))
        for a, b in (
            (one.force, other.force),
            (one.position, other.position),
            (one.velocity, other.velocity),
        )
    )


@dataclass(frozen=True)
class Discrete:
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
class Program:
    """What the kernel runs: laws by address, where they act, their packed parameters. Of the `effects`
    (their number) it was compiled from, `actors` are those that act beside the linear part."""

    mechanics: Mechanics
    discrete: Discrete
    sides: dict[Side, int]
    effects: int
    actors: tuple[_Actor, ...]
    index: Array
    addresses: Array
    ports: Array
    where: Array
    remembers: Array
    at_p: Array
    p: Array

    def states(self, before: float, travel: float) -> tuple[Array, Array]:
        """(where each effect's states begin, all states at the start); `before`, `travel`: see
        `Simulator.run`."""
        states, io = [], np.zeros(IO_SIZE)
        for actor in self.actors:
            effect, packed = actor.effect, actor.packed
            state = effect.initial_state(packed, self.discrete.step)
            state = effect.after_command(state, before)
            if effect.bends:  # who remembers the command has it from there
                io[MEAN], io[SLOPE] = before, 0.0
                actor.law(packed, state, io)
                before = float(io[MEAN])
            states.append(effect.after_travel(state, packed, travel) if travel else state)
        return _packed(states)


def _packed(parts: Sequence[Sequence[float]]) -> tuple[Array, Array]:
    """(where each part begins, all of them in a row)."""
    starts = [0, *itertools.accumulate(len(part) for part in parts[:-1])][: len(parts)]
    values = list(itertools.chain.from_iterable(parts))
    return np.array(starts, np.int64), np.array(values or [0.0])


def _discretise(m: Mechanics, points: Sequence[Point], substeps: int) -> Discrete:
    """exp of [[A, B, 0], [0, 0, I/h], [0, 0, 0]] h: responses to constant and to straight inputs."""
    n, h = m.order, m.sample_time / substeps
    inputs = np.column_stack([m.b, *[p.force for p in points], *[p.force for p, _ in m.bias]])
    k = inputs.shape[1]
    block = np.zeros((n + 2 * k, n + 2 * k))
    block[:n, :n], block[:n, n : n + k] = m.a * h, inputs * h
    block[n : n + k, n + k :] = np.eye(k)
    with np.errstate(over="ignore", invalid="ignore"):
        whole = exponential(block)
    if not np.all(np.isfinite(whole)):
        raise InputError(
            f"a stiffness or damping is beyond what steps of {h:g} s can follow; lower it"
        )
    a, level = whole[:n, :n], whole[:n, n : n + k]
    slope = 2.0 * whole[:n, n + k :] - level  # the ramp s/h enters as its own integral
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
    arrays: list[Any] = [np.ascontiguousarray(piece) for piece in pieces]
    return Discrete(*arrays, h, substeps)  # type: ignore[call-arg]
