"""Bouc-Wen hysteresis: a restoring force that remembers the path."""

from __future__ import annotations

from typing import Any

import numpy as np

from ffl.effects.base import Effect, Extent, Motion, Parameter, Parameters, Setting
from ffl.effects.law import COMMIT, X0, X1
from ffl.effects.paths import bouc_wen, bouc_wen_step
from ffl.effects.solve import end_motion, set_line
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import Array

KINDS = ("saturating", "hardening")
NEAR = 1e-7  # of the displacement: so near to a motion tried, z goes along its slope


def _law(p, s, io):  # type: ignore[no-untyped-def]
    """p: force, displacement, exponent, beta, hardens; s: z, end force (iterate), and of the last motion
    tried: itself, z at its end, slope of z there."""
    if io[COMMIT] != 0.0:
        move = io[X1] - io[X0]
        ahead = move - s[2]
        if abs(ahead) <= NEAR * p[1] and (move >= 0.0) == (s[2] >= 0.0):
            s[0] = s[3] + s[4] * ahead
        else:
            s[0] = bouc_wen_step(s[0], move, p[1], p[2], p[3], p[4])
        return
    start = -p[0] * s[0]
    xa, gx, _, _ = end_motion(io, start, 0.0)
    low, high, force = -2.0 * p[0], 2.0 * p[0], s[1]
    move, z1, share = 0.0, s[0], 1.0
    if p[4] != 0.0:  # between none and that of the motion it does not hold back
        free = -p[0] * bouc_wen_step(s[0], xa - io[X0], p[1], p[2], p[3], p[4])
        low, high = min(free, 0.0), max(free, 0.0)
    for _ in range(60):
        move = xa + gx * force - io[X0]
        z1 = bouc_wen_step(s[0], move, p[1], p[2], p[3], p[4])
        error = force + p[0] * z1
        if error > 0.0:
            high = force
        else:
            low = force
        way = 1.0 - 2.0 * p[4]  # slope of z along the motion, outwards or back
        if (z1 < 0.0) == (move >= 0.0):
            way *= 1.0 - 2.0 * way * p[3]
        share = 1.0 - way * abs(z1) ** p[2]
        following = force - error / (1.0 + p[0] / p[1] * gx * share)
        # Newton's next step goes with the square of this one, as long as the motion does not turn.
        step, size = abs(following - force), max(p[0], abs(force))
        turned = (move >= 0.0) != (xa + gx * following - io[X0] >= 0.0)
        bend = (
            p[2] * (1.0 + 2.0 * p[3]) * (gx * step / p[1]) ** 2 * max(1.0, abs(z1)) ** (2.0 * p[2])
        )
        if step <= 1e-12 * size or (not turned and p[0] * bend <= 1e-13 * size):
            force = following
            break
        force = following if low < following < high else 0.5 * (low + high)
    s[1], s[2], s[3], s[4] = force, move, z1, share / p[1]
    set_line(io, start, force)


class Hysteresis(Effect):
    """F = -force z, in one of two forms (key `kind`), both of Bouc and Wen's law:

    kind "saturating" (default): dz/dt = v/displacement (1 - |z|^n ((1 - beta) + beta sign(v z))),
        |z| <= 1 (normalised; Ismail, Ikhouane, Rodellar 2009, equations (5) and (8));
    kind "hardening": dz/dt = v/displacement (1 + |z|^n ((1 + beta) - beta sign(v z))), stiffer the
        farther it goes and 1 + 2 beta times as much stiffer on the way back: what the law is where
        its gamma + delta < 0 (benchmark of Noel and Schoukens 2016, gamma = 0.8, delta = -1.1).
    """

    name = "hysteresis"
    parameters = (
        Parameter("force", "F", lower=1e-12),
        Parameter("displacement", "x", lower=1e-12, linear=False),
        Parameter("exponent", "", lower=0.5, upper=20.0, linear=False, default=1.0),
        Parameter("beta", "", lower=0.0, upper=10.0, linear=False, default=0.5),
    )
    depends_on = ("position", "direction", "history")
    ladder = ("displacement", np.geomspace(0.2, 5.0, 5))
    options = {"kind": KINDS}  # noqa: RUF012
    siblings = ("presliding_friction", "coulomb_friction", "linear_stiffness", "backlash")
    law = staticmethod(_law)
    remembers = True

    def credible(self, spec: EffectSpec, extent: Extent) -> bool:
        """What no travel turns around is a spring that bends, not a loop."""
        return (
            spec.options.get("kind") == KINDS[1] or spec.parameters["displacement"] < extent.travel
        )

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        return [*super().pack(values, setting), float(setting.options.get("kind") == KINDS[1])]

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0, np.inf, 0.0, 0.0]

    def after_travel(self, state, packed, travel):  # type: ignore[no-untyped-def]
        known = travel if not packed[4] else np.clip(travel, -packed[1], packed[1])  # it runs away
        return [bouc_wen_step(0.0, float(known), *packed[1:]), *state[1:]]

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        return packed[0] / packed[1]

    def reach(self, values: Parameters) -> float:
        return float(values["displacement"])

    def grid(self, motion: Motion) -> list[dict[str, Any]]:
        saturating = [
            {"displacement": float(d), "exponent": n, "beta": beta}
            for d in motion.span * np.geomspace(0.025, 1.0, 7)
            for n in (1.0, 2.0)
            for beta in (0.5, 0.9)
        ]
        hardening = [
            {"displacement": float(d), "exponent": 1.0, "beta": beta, "kind": KINDS[1]}
            for d in motion.span * np.geomspace(0.35, 2.8, 4)
            for beta in (1.0, 4.0)
        ]
        return saturating + hardening

    def regressors(self, motion: Motion, **nonlinear: Any) -> Array:
        hardens = nonlinear.pop("kind", KINDS[0]) == KINDS[1]
        return np.column_stack([-bouc_wen(motion.x, **nonlinear, hardens=hardens)])

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"A hysteretic force of about {self.quantity(values, 'force', plant)} remembers the "
            f"path over about {self.quantity(values, 'displacement', plant)} (Bouc-Wen)."
        )
