"""A plant: linear system with units, its controller, and the effects its file names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from ffl.errors import InputError
from ffl.systems.loop import Controller, Loop, closed_loop
from ffl.systems.state_space import StateSpace
from ffl.systems.zpk import Zpk


@dataclass(frozen=True)
class Physics:
    """What the user knows: `mass` in kg, `motor_constant` in N per input unit, `load_mass` in kg: the
    part of the mass behind the transmission (None: unknown; kg m^2, N m where the output is an angle)."""

    mass: float | None = None
    motor_constant: float | None = None
    load_mass: float | None = None


@dataclass(frozen=True)
class Imperfections:
    """How the real thing differs from mathematics; used when it runs, not by the model, but for
    `command_limit`, to which a diagnosis holds the controller's command as the drive does.

    `encoder_resolution` and `sensor_noise` (standard deviation) in output units, `force_noise`
    (standard deviation) and `command_limit` in input units; zero or None: none.
    """

    encoder_resolution: float = 0.0
    sensor_noise: float = 0.0
    force_noise: float = 0.0
    command_limit: float | None = None

    @property
    def states_noise(self) -> bool:
        """Both kinds of noise are known."""
        return bool(self.sensor_noise and self.force_noise)


@dataclass(frozen=True)
class EffectSpec:
    """An effect as the plant file names it; `ffl.effects` gives it meaning."""

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Plant:
    """y = P u at `sample_time`, controlled by u = C_r r - C_y y + f where it has a controller."""

    name: str
    system: Zpk | StateSpace
    controller: Controller | None = None
    input_unit: str = ""
    output_unit: str = ""
    source: str = ""
    physics: Physics = Physics()
    machine: Imperfections = Imperfections()
    effects: tuple[EffectSpec, ...] = ()

    @property
    def sample_time(self) -> float:
        return self.system.sample_time

    @property
    def is_identified(self) -> bool:
        """Learned by `ffl identify linear` from a recording of this machine, physics and all: numbers
        bent by what it left out are no physics when they straighten."""
        return "ffl identify linear" in self.source

    @cached_property
    def loop(self) -> Loop:
        """The closed loop (open loop without a controller); its stability is not checked here."""
        return closed_loop(self.system, self.controller)

    def require_stable(self) -> Loop:
        """The loop, or one line that says which pole makes it unstable.

        An open-loop machine may integrate: poles on the unit circle are let through without a
        controller, never with one.
        """
        poles = self.loop.poles
        if len(poles) == 0:
            return self.loop
        worst = poles[abs(poles).argmax()]
        limit = 1.0 if self.controller is not None else 1.0 + 1e-6
        if abs(worst) >= limit and not (self.controller is None and abs(worst) <= limit):
            closed = "closed loop" if self.controller is not None else "open-loop plant"
            mend = (
                "change the [controller] gain (its sign first), zeros or poles, or the plant's own gain"
                if self.controller is not None
                else "give a [controller] that stabilises it"
            )
            raise InputError(
                f"{self.name}: the {closed} is unstable, pole {worst.real:.6g}{worst.imag:+.6g}i has "
                f"magnitude {abs(worst):.6g}; {mend}"
            )
        return self.loop
