"""A hypothesis: the linear model with corrections, and effects beside it, as a point to fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ffl.diagnose.hypothesis.coordinate import Coordinate, number_of
from ffl.diagnose.hypothesis.linear import (
    Correction,
    corrected_plant,
    corrections_of,
    loop_by_states,
    simulator_with,
)
from ffl.diagnose.predict.as_sent import as_sent, is_drive
from ffl.diagnose.recorded.commands import EVERYTHING
from ffl.diagnose.recorded.trials import Trial, start_of
from ffl.effects import EFFECTS
from ffl.effects.cascade import lags
from ffl.errors import InputError
from ffl.machines.program import Program
from ffl.machines.simulator import Simulation, Simulator
from ffl.systems.loop import Loop
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

HELD = {  # what the data cannot tell from other numbers of the same effect
    "position_dependent_gain": ("centre",),
    "position_dependent_friction": ("level",),
    "outflow": ("centre",),
}
WALL = 5.0  # times the median of a table: what is believed of its levels
CLIPS = "sensor_nonlinearity"
STIFF = ("presliding_friction", "hysteresis")  # solved implicitly: fewer sub-steps do for a fit
TABLE = "position_dependent_friction"  # the same where its contact gives way
LOAD = "constant_load"  # held beside a table: levels by direction say the same
MOST_SUBSTEPS = 4  # 64 of them change y by 5e-4 of what the contact does, in 13 times the time
ASTRAY = 1e4  # times the largest y, or the travel: what runs farther behind a drive has run away
OVERFLOW = 1e12  # and any run: its squares would overflow
WAVES = ("period", "frequency")
AT_END = 1e-6  # of a logarithm: nearer is at the end
DOUBT = 3.0  # changes that matter (`Correction.scale`) by which an engineer's model is off


@dataclass(frozen=True)
class Base:
    """The nominal plant ready to simulate, and what of its linear part may be off."""

    plant: Plant
    simulator: Simulator
    corrections: tuple[Correction, ...]
    travel: float = 0.0  # range of y in the recordings
    until: float = 0.0  # s, the last time on their clocks
    limit: float | None = None  # of the command, as the plant file states it, where they come to it
    observed: bool = False  # the controller is an observer's, which no command went through
    passing: tuple[float, float] = EVERYTHING  # limit, dead zone beyond which no command is left
    learned: float = np.inf  # range of y in the recordings that are fitted, at most `travel`

    @classmethod
    def of(
        cls,
        plant: Plant,
        travel: float = 0.0,
        until: float = 0.0,
        limit: float | None = None,
        observed: bool = False,
        passing: tuple[float, float] = EVERYTHING,
    ) -> Base:
        simulator = Simulator(plant)
        base = cls(plant, simulator, (), travel, until, limit, observed, passing)
        return replace(base, corrections=corrections_of(simulator.mechanics, base.is_process))

    def like(self, plant: Plant) -> Base:
        """The same recordings of another plant, at no limit."""
        other = Base.of(plant, self.travel, self.until, passing=self.passing)
        return replace(other, learned=self.learned)

    @cached_property
    def unlimited(self) -> Base:
        """What stands behind the drive."""
        return replace(self, limit=None)

    @cached_property
    def loop(self) -> Loop:
        """The stated loop by the simulator's states: what is open of a start is laid on them."""
        return loop_by_states(self.plant, self.simulator)

    @property
    def is_process(self) -> bool:
        """Lags in a row that drive no stated mass: a gain and lags, neither mass nor spring."""
        return bool(len(lags(self.simulator.mechanics))) and not self.states_mass

    def keeps_start(self, trial: Trial) -> bool:
        """Whether `trial` began in motion, in a state that its first samples told and that what follows
        still shows: lags in a row forget theirs."""
        return trial.started and not self.is_process

    @property
    def states_mass(self) -> bool:
        """The plant file knows the mass that moves, or the force that moves it."""
        physics = self.plant.physics
        return physics.mass is not None or physics.motor_constant is not None


@dataclass(frozen=True)
class Model:
    """`base` with `corrections` (missing: zero) and `effects`, beside those that the plant file itself
    states (`given`, None: as stated), whose numbers may be slightly wrong like any other."""

    base: Base
    corrections: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[EffectSpec, ...] = ()
    held: frozenset[str] = frozenset()  # corrections, and effects by name, that stay as they are
    given: tuple[EffectSpec, ...] | None = None
    proven: frozenset[str] = frozenset()  # effects that stand, numbers included, by direct evidence
    unmoved: frozenset[str] = frozenset()  # corrections as stated: an effect stands for them

    @property
    def stated(self) -> tuple[EffectSpec, ...]:
        """The plant file's own effects as they stand."""
        return self.base.plant.effects if self.given is None else self.given

    @property
    def acting(self) -> tuple[EffectSpec, ...]:
        """All effects of a simulation: those found, then those stated; an amplifier comes before the motor,
        whichever was found first."""
        return (*sorted(self.effects, key=lambda spec: not EFFECTS[spec.name].bends), *self.stated)

    @cached_property
    def simulator(self) -> Simulator:
        return simulator_with(self.base.simulator, dict(self.corrections))

    @cached_property
    def substeps(self) -> int:
        """Sub-steps of a sample. `at` keeps them: a step in them would be a step in y."""
        try:
            needed = self.simulator.substeps(self.acting)
        except InputError:  # numbers that no plant can have: every simulation says so
            return 1
        yields = [s.parameters.get("stiffness", 0.0) for s in self.acting if s.name == TABLE]
        stiff = max(yields, default=0.0) > 0.0 or any(s.name in STIFF for s in self.acting)
        return min(MOST_SUBSTEPS, needed) if stiff else needed

    def resettled(self) -> Model:
        """The same numbers, free as they are, with the sub-steps they ask for."""
        object.__setattr__(other := replace(self), "coordinates", self.coordinates)
        return other

    def beyond(self) -> Model:
        """The model with the same way to go once more from where it is, if a length, a time or an exponent
        stands at the end of that which it was given at its start; else the model itself. (A wave stays in
        the lobe that it was found in.)"""
        anew = replace(self)
        for c, now, value in zip(self.coordinates, anew.coordinates, self.theta, strict=True):
            low = value <= c.lower + AT_END and now.lower < c.lower - AT_END
            high = value >= c.upper - AT_END and now.upper > c.upper + AT_END
            if c.log and c.name not in WAVES and (low or high):
                return anew
        return self

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(effect.name for effect in self.effects)

    def simulate(self, trial: Trial, watch: Sequence[tuple[str, float | None]] = ()) -> Simulation:
        """A free run from the recording's own start, behind its drive if observed; `watch` as of `run`."""
        machine, (own,) = self.judged_on([trial]) if self.base.observed else (self, [trial])
        if machine is not self:
            return machine.simulate(own, watch)
        return self.simulator.run(
            self.simulator.prepare(self.acting, self.substeps, watch) if watch else self._program,
            trial.reference,
            trial.feedforward,
            force=trial.load,
            start=start_of(self.base.simulator, self.acting, trial),
            start_time=trial.start_time,
            command_limit=self.base.limit,
            **trial.before_it,
        )

    @cached_property
    def _program(self) -> Program:
        """Made ready once: every recording is run with it."""
        return self.simulator.prepare(self.acting, self.substeps)

    @cached_property
    def behind(self) -> Model:
        """The machine behind all that bends the command of a closed loop, if something found does or its
        stated limit was reached: those are fed with it as recorded (`as_sent`). Else the model itself.
        An observer's loop is led behind what the plant file states as well."""
        bending = self.acting if self.base.observed else self.effects
        drive = [s for s in self.acting if is_drive(EFFECTS[s.name], self.base.observed)]
        bent = self.base.limit is not None or any(spec in drive for spec in bending)
        if self.base.plant.controller is None or not bent:
            return self
        both = self.effects, self.stated
        effects, given = (tuple(s for s in specs if s not in drive) for specs in both)
        return self._stepped(base=self.base.unlimited, effects=effects, given=given)

    @cached_property
    def before_limit(self) -> Model:
        """The machine before a sensor known to clip, or to be blind to the sign."""
        kept = tuple(s for s in self.effects if s.name != CLIPS or s.name not in self.proven)
        return self._stepped(effects=kept)

    def _stepped(self, **changes: Any) -> Model:
        """With `changes`, in the sub-steps of this one."""
        other = replace(self, **changes)
        object.__setattr__(other, "substeps", self.substeps)
        return other

    def judged_on(self, trials: Sequence[Trial]) -> tuple[Model, list[Trial]]:
        """The machine and recordings that it is judged on: behind its drive, where all commands are
        known, and before its sensor's limit, where this is: what was lost beyond, nobody judges; before its
        sensor, where this lost no more than signs that could be read."""
        if all(trial.lost is not None or trial.folded for trial in trials):
            return self.before_limit, list(trials)
        if self.behind is not self:
            sent = [as_sent(trial, self.acting, self.base.observed) for trial in trials]
            if all(trial is not None for trial in sent):
                return self.behind, [trial for trial in sent if trial is not None]
        return self, list(trials)

    def follow(self, trial: Trial, watch: Sequence[tuple[str, float | None]] = ()) -> Simulation:
        """The run that the model is judged by; `simulate` but for what bends the command."""
        machine, (own,) = self.judged_on([trial])
        return machine.simulate(own, watch)

    def attempt(self, trial: Trial) -> Simulation | None:
        """`follow`, None where there is no such machine or it leaves all bounds. (Behind a dead zone, or
        led by an observer, a loop that is unstable runs away: there is no limit at which it cycles.)"""
        try:
            run = self.follow(trial)
        except InputError:
            return None
        most = OVERFLOW if self.behind is self else ASTRAY
        bound = most * max(float(np.abs(trial.y).max()), self.base.travel)
        return None if run.diverged or np.abs(run.y).max() > bound else run

    def output(self, trial: Trial) -> Array | None:
        """y of `attempt`, simulated once: what is judged, weighed and begun from is often the same."""
        known = self._outputs.get(trial.drive)
        if known is None:
            run = self.attempt(trial)
            if run is None:
                return None
            self._outputs[trial.drive] = known = (trial, run.y)
        return known[1]

    @cached_property
    def _outputs(self) -> dict[tuple[object, ...], tuple[Trial, Array]]:
        """By what drives the simulation, with the trial that had it: no other takes its identity."""
        return {}

    def plant(self) -> Plant:
        """The plant file's plant: corrections in its linear part, effects beside it."""
        plant = corrected_plant(
            self.base.plant, self.base.simulator.mechanics, dict(self.corrections)
        )
        return replace(plant, effects=self.acting)

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        return (
            *self._corrections(),
            *self._numbers("given", self.stated),
            *self._numbers("effect", self.effects),
        )

    def _corrections(self) -> Iterator[Coordinate]:
        for c in self.base.corrections:
            if c.name in self.held | self.unmoved or (c.asked and c.name not in self.corrections):
                continue
            yield Coordinate(
                "correction", c.name, -1, None, c.scale, c.lower, c.upper, doubt=DOUBT * c.scale
            )

    def _numbers(self, kind: str, specs: Sequence[EffectSpec]) -> Iterator[Coordinate]:
        for i, spec in enumerate(specs):
            if kind == "effect" and (spec.name in self.proven or spec.name in self.held):
                continue
            effect = EFFECTS[spec.name]
            own = [parameter.name for parameter in effect.parameters]
            fixed = (*HELD.get(spec.name, ()), *effect.idle(spec.parameters))
            for name in (*own, *(n for n in spec.parameters if n not in own)):
                parameter = effect.parameter(name)
                value = spec.parameters.get(name)
                if isinstance(value, str) or value is None or name in fixed or parameter.known:
                    continue
                if isinstance(value, Mapping):
                    # A knot at the end of what the machine travelled is hardly seen: free to go anywhere
                    # it did, to a wall of 200,000 times the friction elsewhere.
                    levels = np.abs([*value["positive"], *value["negative"]])
                    doubt = WALL * float(np.median(levels)) or np.inf
                    for key in ("positive", "negative"):
                        size = float(np.mean(np.abs(value[key]))) or 1.0
                        for j in range(len(value[key])):
                            yield Coordinate(kind, name, i, (key, j), size, 0.0, doubt=doubt)
                    continue
                yield number_of(self.base, kind, i, spec, parameter, float(value))
            if kind == "effect":
                for name, (_, low, high) in effect.free_options(spec.options).items():
                    yield Coordinate(
                        "option", name, i, None, 1.0, float(np.log(low)), float(np.log(high)), True
                    )
        if kind == "effect" and self.mass_ratio is not None:  # one machine has one
            yield Coordinate("option", "mass_ratio", -1, None, 1.0, np.log(0.05), np.log(20), True)

    @cached_property
    def theta(self) -> Array:
        """The free numbers in the order of `coordinates`."""
        return np.array([self._read(c) for c in self.coordinates])

    def _read(self, c: Coordinate) -> float:
        if c.kind == "correction":
            return float(self.corrections.get(c.name, 0.0))
        if c.kind == "option" and c.effect < 0:
            return float(np.log(self.mass_ratio or 1.0))
        if c.kind == "option":
            spec = self.effects[c.effect]
            return float(np.log(EFFECTS[spec.name].free_options(spec.options)[c.name][0]))
        spec = (self.stated if c.kind == "given" else self.effects)[c.effect]
        value = spec.parameters[c.name]
        if c.place is not None:
            return float(value[c.place[0]][c.place[1]])
        return float(np.log(value)) if c.log else float(value)

    def at(self, theta: Array) -> Model:
        """The model with other numbers."""
        corrections = dict(self.corrections)
        specs = {"effect": self.effects, "given": self.stated}
        parameters = {k: [dict(spec.parameters) for spec in v] for k, v in specs.items()}
        options = [dict(spec.options) for spec in self.effects]
        shared = [option for option in options if option.get("mass_ratio") is not None]
        for c, number in zip(self.coordinates, theta, strict=True):
            number = float(min(max(number, c.lower), c.upper))
            if c.kind == "correction":
                corrections[c.name] = number
            elif c.kind == "option":
                for option in shared if c.effect < 0 else [options[c.effect]]:
                    option[c.name] = float(np.exp(number))
            elif c.place is not None:
                values = parameters[c.kind][c.effect]
                row = list(values[c.name][c.place[0]])
                row[c.place[1]] = number
                values[c.name] = {**values[c.name], c.place[0]: row}
            else:
                parameters[c.kind][c.effect][c.name] = float(np.exp(number)) if c.log else number
        for kind, listed in specs.items():
            for spec, values in zip(listed, parameters[kind], strict=True):
                _keep_sound(spec.name, values)
        effects, given = (
            tuple(replace(spec, parameters=p) for spec, p in zip(v, parameters[k], strict=True))
            for k, v in specs.items()
        )
        effects = tuple(replace(e, options=o) for e, o in zip(effects, options, strict=True))
        other = Model(self.base, corrections, effects, self.held, given, self.proven, self.unmoved)
        object.__setattr__(other, "coordinates", self.coordinates)
        if "substeps" in self.__dict__:
            object.__setattr__(other, "substeps", self.substeps)
        return other

    @property
    def mass_ratio(self) -> float | None:
        """Mass at the motor over mass at the load that the effects share; None: of no matter."""
        ratios = [spec.options.get("mass_ratio") for spec in self.effects]
        return next((float(ratio) for ratio in ratios if ratio is not None), None)

    def with_effect(self, spec: EffectSpec) -> Model:
        if self.mass_ratio is not None and spec.options.get("mass_ratio") is not None:
            spec = replace(spec, options={**spec.options, "mass_ratio": self.mass_ratio})
        return replace(self, effects=(*self.effects, spec))

    def with_proven(self, spec: EffectSpec) -> Model:
        """With an effect that the recordings show directly: it stands, numbers included."""
        return replace(self.with_effect(spec), proven=self.proven | {spec.name})

    def with_parameters(self, index: int, parameters: Mapping[str, Any]) -> Model:
        """With other numbers of effect `index`."""
        effects = list(self.effects)
        effects[index] = replace(effects[index], parameters=parameters)
        return replace(self, effects=tuple(effects))

    def without(self, index: int) -> Model:
        return replace(self, effects=self.effects[:index] + self.effects[index + 1 :])


def _keep_sound(name: str, values: dict[str, Any]) -> None:
    """What an effect demands of its parameters together."""
    if name == "stribeck_friction":
        values["static_level"] = max(values["static_level"], values["coulomb_level"])
    if "table" in values:
        levels = [values["table"]["positive"], values["table"]["negative"]]
        values["level"] = float(np.mean(levels))
