"""A part of the moving mass on a spring, which the model takes for rigid."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from ffl.effects.base import Effect, Extent, Motion, Parameter, Parameters, Setting
from ffl.effects.mechanics import Mechanics
from ffl.effects.resonance import resonance_of
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

NEARBY, MACHINE = "nearby", "machine"  # what the part resonates against


class FlexibleMode(Effect):
    """The share `mass_fraction` of the moving mass M hangs on a spring and a damper.

    With m2 = mu M and m1 what moves at once with the point that it hangs at (1/m1: the acceleration that
    a unit force makes there, without the part): resonance (2 pi f)^2 = k (1/m1 + 1/m2), damper
    c = 2 damping (2 pi f)/(1/m1 + 1/m2). On a rigid machine m1 = (1 - mu) M, with the anti-resonance
    (2 pi f)^2 (1 - mu) seen from the motor; with modes of its own, slower ones, m1 is the mass nearby
    alone, and f the frequency at which the part is seen to resonate there. The total mass stays M.
    Key `measured` = "motor" (default: the sensor stays where it was) or
    "load" (the sensor moves with the hung mass).
    Key `resonance` = "nearby" (default: frequency and damping as above, defined for all numbers) or
    "machine" (they are those of a pole of the whole, `ffl.effects.resonance`: what a measured frequency
    response shows, and what a diagnosis tells).
    """

    name = "flexible_mode"
    parameters = (
        Parameter("frequency", "Hz", lower=1e-6, linear=False),
        Parameter("damping", "", upper=1.0, linear=False, default=0.01),
        Parameter("mass_fraction", "", lower=1e-9, upper=0.999),
    )
    depends_on = ("acceleration", "time")
    ladder = ("mass_fraction", np.geomspace(0.2, 5.0, 5))
    valleys = "frequency"  # a line; what is slow is seen from far away and is another's
    siblings = ("mass_change", "actuator_lag", "input_delay", "sensor_lead")
    options = {"measured": ("motor", "load"), "resonance": (NEARBY, MACHINE)}  # noqa: RUF012
    sides = ("sensor", "motor")

    def turn(self, spec: EffectSpec) -> int:
        return 0

    def modify(self, mechanics: Mechanics, values: Parameters, setting: Setting) -> Mechanics:
        return mechanics.with_part_on_spring(
            self.name,
            (self.side_in(setting), setting.mass_ratio),
            values["mass_fraction"],
            values["frequency"],
            values["damping"],
            setting.options.get("measured", "motor") == "load",
            whole=setting.options.get("resonance", NEARBY) == MACHINE,
        )

    def seen(self, spec: EffectSpec, whole: Mechanics) -> EffectSpec:
        resonance = resonance_of(whole.a, whole.point(self.name))
        if resonance is None:
            return spec
        told = dict(zip(("frequency", "damping"), resonance, strict=True))
        return replace(
            spec,
            parameters={**spec.parameters, **told},
            options={**spec.options, "resonance": MACHINE},
        )

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        top = 0.4 / motion.sample_time
        low = max(2.0 / (len(motion.t) * motion.sample_time), top / 1e4)
        return [
            {"frequency": float(f), "damping": z}
            for f in np.geomspace(low, top, 60)
            for z in (0.01, 0.1)
        ]

    def credible(self, spec: EffectSpec, extent: Extent) -> bool:
        """A mode resonates: above a damping of 1/sqrt(2) the hung mass answers no frequency by more
        than it does a slow one."""
        return bool(spec.parameters["damping"] < np.sqrt(0.5))

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """M (a - H a), H the hung mass's own second-order response: first order in mass_fraction."""
        from scipy.signal import lfilter

        b, a = _hung(nonlinear["frequency"], nonlinear["damping"], motion.sample_time)
        held = lfilter(b, a, motion.a)
        return np.column_stack([motion.mass * (motion.a - held)])

    def compensation(self, motion: Motion, **nonlinear: float) -> Array | None:
        return None

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"Of the moving mass, {100 * values['mass_fraction']:.3g} % sits on a spring, with its "
            f"resonance at {values['frequency']:.4g} Hz (damping {values['damping']:.2g})."
        )


@lru_cache(maxsize=512)
def _hung(frequency: float, damping: float, sample_time: float) -> tuple[Array, Array]:
    """Numerator and denominator of the hung mass's own response, straight between samples."""
    from scipy.signal import cont2discrete

    pulsation = 2.0 * np.pi * frequency
    top = [2.0 * damping * pulsation, pulsation**2]
    b, a, _ = cont2discrete((top, [1.0, *top]), sample_time, method="foh")
    return b[0], a
