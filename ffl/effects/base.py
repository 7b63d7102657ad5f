"""What an effect is: one piece of physics beside the linear plant, written once.

An `Effect` is a stateless object in the dict `EFFECTS`; a plant file's `[[effects]]` entry is an
`EffectSpec` (name, parameters, options) that it gives meaning to. One effect serves

simulation  `law` (how it acts in a step, see `ffl.effects.law`), with `pack`, `initial_state`,
            `stiffness` and `weakening`; or `modify`, for what belongs to the linear part (mass,
            damping, stiffness, a mode), which then costs nothing in the kernel;
diagnosis   `grid` (values of the non-linear parameters worth trying, from the data), `regressors`
            (signals, linear in the rest), `from_coefficients` (fitted coefficients to parameters),
            `parameters` with units and bounds, `component`, `depends_on`, `siblings`;
feedforward `compensation` (regressors that cancel it, from the motion of the reference);
the report  `says`.

Ports. `port` names where the signal of an effect enters the loop: 'force' (beside the force on the
plant, in newton where `motor_constant` is known, so divide by it to get to u), 'command' (added to
the command between controller and plant, in the input's unit), 'output' (added to the measured
output), 'flow' (between and after the stages of a row of lags, `ffl.effects.cascade`; without
regressors: the diagnosis takes the difference that a simulation makes). Regressors of an effect are
signals at its port: filter a force or command regressor with the process sensitivity (a force one
divided by the motor constant), an output regressor with the sensitivity, and the sum over columns of
coefficient * filtered regressor is the effect's first-order contribution to y.

Motion. Regressors are computed from *simulated* motion (`Motion`), never from y smoothed without
delay: that leaks the present noise into the regression.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ffl.effects.mechanics import Mechanics
from ffl.effects.modal import force_unit, is_speed
from ffl.effects.motion import Extent, Motion
from ffl.effects.point import Point
from ffl.errors import InputError
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.plant_file import suggest
from ffl.systems.state_space import Array

Parameters = Mapping[str, Any]


@dataclass(frozen=True)
class Parameter:
    """A parameter: `unit` in F (force), x (position), y (output), s, Hz, rad; bounds; `linear` where the
    contribution is; `optional` with a default; `stepped` where the motion changes with it in steps, so that
    no slope tells how sure it is; `neutral`: where it does nothing; `known`: stated, never fitted."""

    name: str
    unit: str
    lower: float = 0.0
    upper: float = np.inf
    linear: bool = True
    default: float | None = None
    stepped: bool = False
    neutral: float = 0.0
    known: bool = False

    @property
    def is_place(self) -> bool:
        """Where something lies, or a wave begins: 0 is a number like any other."""
        return self.unit in ("x", "rad") and self.lower == -np.inf

    def unit_in(self, plant: Plant) -> str:
        """The unit in words: 'N s/m' where the motor constant is known, else in the input's unit."""
        measured = plant.output_unit or "output"
        words = {"F": force_unit(plant), "u": plant.input_unit or "input"}
        words |= dict.fromkeys("xy", measured)
        if is_speed(measured) and "x" in self.unit:  # x is the integral of what is measured
            words["x"] = "\0"
        text = " ".join(
            "/".join(_power(part, words) for part in word.split("/")) for word in self.unit.split()
        )
        text = text.replace("\0/s", measured).replace(" s/\0", f"/({measured})")
        text = text.replace(" s^2/\0^2", f"/({measured})^2")
        return text.replace("\0", measured[:-2] if measured.endswith("/s") else f"({measured} s)")


def _power(word: str, words: Mapping[str, str]) -> str:
    return words.get(word[:1], word[:1]) + word[1:] if word[:1] in words else word


Law = Callable[[Any, Any, Any], None]


class Effect:
    """Base of all effects; a new one is one file with one subclass and one line in `EFFECTS`.

    Class attributes: `name`; `component` (actuator, plant, transmission, sensor, environment,
    timing); `port` ('force', 'command', 'output', 'flow'); `parameters`; `depends_on`; `siblings` (names of
    effects it is easily taken for: fit them all before adding a second effect); `law` (None for
    effects of the linear part); `sides` it may act on; `scan` ('position' or 'time': the first
    parameter of `grid` is a period in x or a frequency in t, better searched all at once by a
    Fourier transform over x or t than value by value); `fixed_amount` (the coefficient of its
    regressor is 1 by nature; a fitted one far from 1 speaks against the effect); `remembers` (its
    force law has a state, and so is called once more, with COMMIT, when the sub-step is solved);
    `needs_mass` (its force asks for the velocity of a driven mass, which a tank does not have);
    `stages` (at port 'flow': lags in a row that it needs at least); `of_processes` (looked for where
    lags drive no stated mass); `of_angles` (looked for where the output is an angle in rad);
    `switches` (its force jumps at v = 0, which excites modes: shorter steps where there are any);
    `ladder` (where the cost is not convex: the parameter that decides, and factors on what the
    regressor proposes for it, from which simulations begin); `valleys` (a parameter of `grid` along which
    the cost has several valleys: simulations begin in each that the regressor sees).
    """

    name: ClassVar[str]
    component: ClassVar[str] = "plant"
    port: ClassVar[str] = "force"
    parameters: ClassVar[tuple[Parameter, ...]]
    depends_on: ClassVar[tuple[str, ...]] = ()
    siblings: ClassVar[tuple[str, ...]] = ()
    options: ClassVar[Mapping[str, Any]] = {}
    law: ClassVar[Any] = None
    sides: ClassVar[tuple[str, ...]] = ("sensor", "motor", "load")
    default_side: ClassVar[str] = "sensor"
    scan: ClassVar[str] = ""
    fixed_amount: ClassVar[bool] = False
    remembers: ClassVar[bool] = False
    needs_mass: ClassVar[bool] = True
    stages: ClassVar[int] = 1
    of_processes: ClassVar[bool] = False
    of_angles: ClassVar[bool] = False
    switches: ClassVar[bool] = False
    ladder: ClassVar[tuple[str, Array] | None] = None
    valleys: ClassVar[str] = ""

    # --- reading ---------------------------------------------------------------------------------

    def parameter(self, name: str) -> Parameter:
        """The parameter `name`, or `InputError` with a suggestion."""
        if name in (known := [parameter.name for parameter in self.parameters]):
            return self.parameters[known.index(name)]
        own = {"side", "mass_ratio", *self.options}
        said = "it stands beside parameters" if name in own else suggest(name, known)
        raise InputError(f"effect {self.name}: unknown parameter '{name}'; {said}")

    def check(self, spec: EffectSpec) -> dict[str, Any]:
        """The parameters of `spec`, complete and within bounds, else `InputError` in one line."""
        values: dict[str, Any] = {}
        for name, value in spec.parameters.items():
            values[name] = self.check_value(self.parameter(name), value)
        for parameter in self.parameters:
            if parameter.name not in values:
                if parameter.default is None:
                    raise InputError(
                        f"effect {self.name}: parameter '{parameter.name}' is missing; add it to "
                        "parameters"
                    )
                values[parameter.name] = parameter.default
        for name, value in spec.options.items():
            self.check_option(name, value)
        return values

    def require(self, sound: bool, message: str) -> None:
        """`InputError` that names the effect, unless `sound`."""
        if not sound:
            raise InputError(f"effect {self.name}: {message}")

    def check_option(self, name: str, value: Any) -> None:
        """Keys beside `name` and `parameters`: `side`, `mass_ratio`, and the effect's `options`."""
        known = {"side": self.sides, "mass_ratio": None, **self.options}
        if name not in known:
            raise InputError(
                f"effect {self.name}: unknown key '{name}'; {suggest(name, list(known))}"
            )
        choices = known[name]
        if choices is not None and value not in choices:
            raise InputError(
                f"effect {self.name}: {name} = '{value}'; take one of {', '.join(choices)}"
            )
        if choices is None and not (isinstance(value, int | float) and value > 0):
            raise InputError(f"effect {self.name}: {name} = {value} must be a positive number")

    def check_value(self, parameter: Parameter, value: Any) -> Any:
        """One value within its bounds."""
        if isinstance(value, bool) or not isinstance(value, int | float | np.floating):
            raise InputError(f"effect {self.name}: {parameter.name} = {value!r} must be a number")
        if not np.isfinite(value):
            raise InputError(f"effect {self.name}: {parameter.name} = {value} must be finite")
        if not parameter.lower <= value <= parameter.upper:
            raise InputError(
                f"effect {self.name}: {parameter.name} = {value:g} must lie between "
                f"{parameter.lower:g} and {parameter.upper:g}"
            )
        return float(value)

    def free_options(self, options: Mapping[str, Any]) -> dict[str, tuple[float, float, float]]:
        """Positive numbers among `options` that a fit may move: value, least, most."""
        return {}

    # --- simulation ------------------------------------------------------------------------------

    def port_in(self, setting: Setting) -> str:
        """The port in this setting, for effects with several forms."""
        return self.port

    def law_in(self, setting: Setting) -> Law | None:
        """The law in this setting, for effects with several forms."""
        return self.law

    def side_in(self, setting: Setting) -> str:
        """The side it acts on in this setting."""
        return str(setting.options.get("side", self.default_side))

    def parts(self, values: Parameters, setting: Setting) -> list[Part]:
        """Where it acts, and by which law: one point for most, none for the linear part's."""
        law = self.law_in(setting)
        if law is None:
            return []
        return [Part(self.side_in(setting), setting.mass_ratio, law, self.pack(values, setting))]

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        """Numbers for the law; parameters whose unit has F in it are divided by the motor constant."""
        return [
            values[p.name] / setting.force_per_input if "F" in p.unit else values[p.name]
            for p in self.parameters
        ]

    def initial_state(self, packed: Sequence[float], step: float) -> list[float]:
        """State at the start; its length is the number of states."""
        return []

    def after_command(self, state: list[float], command: float) -> list[float]:
        """`state` as a `command` (input units) leaves it that was held until the first sample; what
        remembers no command is as it was."""
        return state

    @property
    def bends(self) -> bool:
        """Whether it makes of each command another one, by that and the commands before it alone, and at
        once: what is late depends on the time."""
        return self.port == "command" and set(self.depends_on) <= {"command", "history"}

    @property
    def remembers_command(self) -> bool:
        return type(self).after_command is not Effect.after_command

    def after_travel(
        self, state: list[float], packed: Sequence[float], travel: float
    ) -> list[float]:
        """`state` as a `travel` in one direction (output units, signed) leaves it that ended at the first
        sample; what remembers no path is as it was."""
        return state

    def reach(self, values: Parameters) -> float:
        """Travel in one direction (output units) over which the path before is forgotten, but for a
        factor; 0 where none is remembered."""
        return 0.0

    def stiffness(self, packed: Sequence[float]) -> float:
        """Largest force per displacement the law can show, input unit / output unit: decides how
        many sub-steps a sample is cut into."""
        return 0.0

    def weakening(self, packed: Sequence[float]) -> float:
        """Largest fall of the force per velocity, input unit s / output unit: friction that falls
        with speed runs away within a step if the step is long."""
        return 0.0

    def turn(self, spec: EffectSpec) -> int:
        """When it changes the linear part: 0 who divides the machine, 1 a mass that changes in all parts, 2
        who adds forces to that."""
        return 2

    def modify(self, mechanics: Mechanics, values: Parameters, setting: Setting) -> Mechanics:
        """The linear part with the effect in it; unchanged where `law` does the work."""
        return mechanics

    def seen(self, spec: EffectSpec, whole: Mechanics) -> EffectSpec:
        """`spec` by the numbers that are seen from outside `whole`, the machine with it, if others."""
        return spec

    def credible(self, spec: EffectSpec, extent: Extent) -> bool:
        """Whether the numbers of `spec`, found over recordings of this `extent`, are of the physics that it
        is named for, not of what stands in for it."""
        return True

    def idle(self, values: Parameters) -> tuple[str, ...]:
        """Parameters that do nothing in the form that `values` give the effect."""
        return ()

    def order(self, values: Parameters) -> int:
        """-1: it acts before all others at its port, wherever it is named, but for what bends the command
        before any other; 1: after them (a scale ends, however it bends)."""
        return 0

    def shown(self, values: Parameters, position: Any) -> Any:
        """What the sensor shows of a machine that stands still at `position`, one or (N,)."""
        return position

    def passes(self, values: Parameters, seen: Array) -> Array | None:
        """(N,) what a sensor shows of a small change where it would show `seen` without the effect, a
        share of it; None where that is all."""
        return None

    # --- diagnosis -------------------------------------------------------------------------------

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        """Values of the non-linear parameters to try, from the data; [{}] where there are none."""
        return [{}]

    def scaled(self, values: Parameters, name: str, factors: Array) -> Array:
        """Rungs of the parameter `name` of its `ladder`."""
        return values[name] * factors

    def rung(self, values: Parameters, name: str, value: float) -> dict[str, Any]:
        """`values` with another `value` of the parameter `name` of its `ladder`: a start like this one."""
        return {**values, name: value}

    def forms(self, flexible: bool, sample_time: float = 0.0) -> list[dict[str, Any]]:
        """Options of each form it can take on a plant with modes (`flexible`) or without, sampled so."""
        return [{}]

    def regressors(self, motion: Motion, **nonlinear: Any) -> Array:
        """(N, k) signals at `port`, for the coefficients that `from_coefficients` reads."""
        raise InputError(f"effect {self.name} has no regressors")

    def from_coefficients(
        self, coefficients: Array, nonlinear: Mapping[str, float]
    ) -> dict[str, Any]:
        """Parameters from fitted coefficients; magnitudes outside their bounds are clipped."""
        names = [p.name for p in self.parameters if p.linear]
        values = dict(nonlinear)
        for name, value in zip(names, coefficients, strict=True):
            parameter = self.parameter(name)
            values[name] = float(np.clip(value, parameter.lower, parameter.upper))
        return values

    def nonlinear_of(self, values: Parameters) -> dict[str, Any]:
        """The arguments of `regressors` here: what the coefficients of `from_coefficients` leave out."""
        return {p.name: values[p.name] for p in self.parameters if not p.linear}

    def coefficients_of(self, values: Parameters) -> Array:
        """The coefficients of `regressors` for these parameters: `from_coefficients` backwards."""
        if self.fixed_amount:
            return np.ones(1)
        return np.array([float(values[p.name]) for p in self.parameters if p.linear])

    def signal(self, spec: EffectSpec, motion: Motion) -> Array:
        """(N,) what the effect adds at its port along the motion: its form's `regressors`, weighted."""
        values = self.check(spec)
        form = {name: value for name, value in spec.options.items() if name in self.options}
        columns = self.regressors(motion, **form, **self.nonlinear_of(values))
        return np.asarray(columns @ self.coefficients_of(values))

    # --- feedforward -----------------------------------------------------------------------------

    def compensated_along(self, values: Parameters) -> dict[str, Any]:
        return self.nonlinear_of(values)  # the arguments of `compensation`

    def compensation(self, motion: Motion, **nonlinear: float) -> Array | None:
        """(N, k) signals, in the unit of the port, that cancel the effect when weighted with its
        coefficients, `motion.u` what the rest of the machine takes; None: there are none."""
        return -self.regressors(motion, **nonlinear) if self.port == "force" else None

    # --- words -----------------------------------------------------------------------------------

    def says(self, values: Parameters, plant: Plant) -> str:
        """One sentence for an engineer; `values`: the parameters, and the options beside them."""
        raise InputError(f"effect {self.name} has no sentence")

    def quantity(self, values: Parameters, name: str, plant: Plant) -> str:
        """'20.4 N' for parameter `name`."""
        return f"{values[name]:.4g} {self.parameter(name).unit_in(plant)}".strip()


@dataclass(frozen=True)
class Part:
    """A law at a point of the mechanics (`side` and `mass_ratio`) with its `packed` numbers."""

    side: str
    mass_ratio: float | None
    law: Law
    packed: list[float]


@dataclass(frozen=True)
class Setting:
    """What an effect must know of its surroundings: newton per input unit (1 where unknown: forces
    are then in the input's unit), the linear part, and the options of this instance."""

    force_per_input: float
    mechanics: Mechanics
    options: Mapping[str, Any]

    @property
    def sample_time(self) -> float:
        return self.mechanics.sample_time

    @property
    def mass_ratio(self) -> float | None:
        return self.options.get("mass_ratio")

    def point(self, side: str) -> Point:
        return self.mechanics.point(side, self.mass_ratio)
