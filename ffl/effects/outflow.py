"""Tanks that empty through orifices: the outflow goes with the root of the level (Torricelli)."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters, Part, Setting
from ffl.effects.cascade import BETWEEN, OUT, lags
from ffl.effects.law import X0
from ffl.effects.solve import bulge_of, end_motion, set_curve
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: centre - empty = l, empty. Beside the lag's own flow x this flows: -l (1 - r)^2 with the root
    r = sqrt((x - empty)/l), which makes the end of the step a quadratic equation in r; an empty tank
    lets nothing through, however far the linear model would draw it down."""
    l, empty = p[0], p[1]
    r0 = np.sqrt(max(io[X0] - empty, 0.0) / l)
    start, end, bulge = -l * (1.0 - r0) ** 2, 0.0, 0.0
    for _ in range(4):
        xa, gx, _, _ = end_motion(io, start, bulge)
        short = empty + gx * l - xa
        r1 = 0.0
        if short < 0.0:
            a, b = l * (1.0 + gx), -gx * l
            r1 = (np.sqrt(b * b - a * short) - b) / a
        end = -l * (1.0 - r1) ** 2
        half = 0.5 * (io[X0] + xa + gx * end)
        rm = np.sqrt(max(half - empty, 0.0) / l)
        bulge = bulge_of(start, -l * (1.0 - rm) ** 2, end)
    set_curve(io, start, end, bulge)


class Outflow(Effect):
    """Flow out of each stage: centre + 2 l (sqrt((x - empty)/l) - 1), l = centre - empty, in place of
    its level x: the linear model at `centre`, nothing at `empty`.

    x is the level of the stage on the scale of the sensor (see `ffl.effects.cascade`). With both
    stages at rest at one flow the same two numbers hold for both: each is empty where nothing flows.
    `side`: the lag that is the upper stage; "after_slow", "after_fast": the lower stage alone, where
    the upper one is no tank but just that lag.
    """

    name = "outflow"
    port = "flow"
    sides = (*BETWEEN, *OUT)
    default_side = BETWEEN[0]
    parameters = (
        Parameter("empty", "x", lower=-np.inf, linear=False),
        Parameter("centre", "x", lower=-np.inf, linear=False),
    )
    depends_on = ("position",)
    siblings = ("overflow", "spill", "sensor_bend", "linear_stiffness", "position_dependent_gain")
    fixed_amount = True
    ladder = ("empty", np.geomspace(0.4, 2.5, 7))  # of the way down from the centre
    needs_mass = False
    law = staticmethod(_law)

    def check(self, spec):  # type: ignore[no-untyped-def]
        values = super().check(spec)
        self.require(
            values["empty"] < values["centre"],
            f"empty = {values['empty']:g} must lie below centre = {values['centre']:g}, the level at "
            "which the linear model holds",
        )
        return values

    def parts(self, values: Parameters, setting: Setting) -> list[Part]:
        packed = [values["centre"] - values["empty"], values["empty"]]
        side = self.side_in(setting)
        places = [side] if side in OUT else [f"after_{side}", side]
        if len(lags(setting.mechanics)) == 1:
            places = list(OUT[:1])
        return [Part(place, None, _law, packed) for place in places]

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        """A linear model holds at its operating point, 0, or where it was identified."""
        below = float(motion.x.min()) - motion.span * np.array([0.02, 0.15, 0.4, 1.0])
        return [
            {"empty": float(empty), "centre": centre}
            for centre in (0.0, motion.middle)
            for empty in below
            if empty < centre
        ]

    def scaled(self, values: Parameters, name: str, factors: Array) -> Array:
        return values["centre"] - (values["centre"] - values["empty"]) * factors

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return dict(nonlinear)

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            "What flows out goes with the root of the level above "
            f"{self.quantity(values, 'empty', plant)} (Torricelli), not in proportion to it."
        )
