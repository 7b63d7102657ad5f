"""Bouc-Wen hysteresis: a restoring force that remembers the path."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Motion, Parameter, Parameters
from ffl.effects.law import COMMIT, X0, X1
from ffl.effects.paths import bouc_wen, bouc_wen_step
from ffl.effects.solve import end_motion, set_line
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: force, displacement, exponent, beta; s: z, end force (iterate)."""
    if io[COMMIT] != 0.0:
        s[0] = bouc_wen_step(s[0], io[X1] - io[X0], p[1], p[2], p[3])
        return
    start = -p[0] * s[0]
    xa, gx, _, _ = end_motion(io, start, 0.0)
    low, high, force = -2.0 * p[0], 2.0 * p[0], s[1]
    for _ in range(60):
        z1 = bouc_wen_step(s[0], xa + gx * force - io[X0], p[1], p[2], p[3])
        error = force + p[0] * z1
        if error > 0.0:
            high = force
        else:
            low = force
        share = 1.0 - abs(z1) ** p[2]  # slope of z along the motion, near enough for Newton
        following = force - error / (1.0 + p[0] / p[1] * gx * share)
        if abs(following - force) <= 1e-12 * p[0]:
            force = following
            break
        force = following if low < following < high else 0.5 * (low + high)
    s[1] = force
    set_line(io, start, force)


class Hysteresis(Effect):
    """F = -force z, dz/dt = v/displacement (1 - |z|^n ((1 - beta) + beta sign(v z))), |z| <= 1
    (Bouc-Wen, normalised; Ismail, Ikhouane, Rodellar 2009, equations (5) and (8))."""

    name = "hysteresis"
    parameters = (
        Parameter("force", "F", lower=1e-12),
        Parameter("displacement", "x", lower=1e-12, linear=False),
        Parameter("exponent", "", lower=0.5, upper=20.0, linear=False, default=1.0),
        Parameter("beta", "", lower=0.0, upper=1.0, linear=False, default=0.5),
    )
    depends_on = ("position", "direction", "history")
    ladder = ("displacement", np.geomspace(0.2, 5.0, 5))
    siblings = ("presliding_friction", "coulomb_friction", "linear_stiffness", "backlash")
    law = staticmethod(_law)
    remembers = True

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0]

    def after_travel(self, state, packed, travel):  # type: ignore[no-untyped-def]
        return [bouc_wen_step(0.0, travel, *packed[1:4]), state[1]]

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        return packed[0] / packed[1]

    def reach(self, values: Parameters) -> float:
        return float(values["displacement"])

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [
            {"displacement": float(d), "exponent": n, "beta": beta}
            for d in motion.span * np.geomspace(0.025, 1.0, 7)
            for n in (1.0, 2.0)
            for beta in (0.5, 0.9)
        ]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        return np.column_stack([-bouc_wen(motion.x, **nonlinear)])

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"A hysteretic force of up to {self.quantity(values, 'force', plant)} remembers the "
            f"path over about {self.quantity(values, 'displacement', plant)} (Bouc-Wen)."
        )
