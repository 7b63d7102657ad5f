"""Lost motion between motor and load."""

from __future__ import annotations

import numpy as np

from ffl.effects.base import Effect, Law, Motion, Parameter, Parameters, Setting
from ffl.effects.law import FIRST, MEAN, V0, X0
from ffl.effects.paths import play
from ffl.effects.solve import end_motion, set_line
from ffl.systems.plant import Plant
from ffl.systems.state_space import Array


def _play_law(p, s, io):  # type: ignore[no-untyped-def]
    """p: gap; s: output of the play relative to y, started (0 or 1).

    The load stays where it is while the motor crosses the gap (a load held by its own friction).
    """
    half = 0.5 * p[0]
    if s[1] == 0.0:
        s[0], s[1] = io[X0], 1.0
    s[0] = min(max(s[0], io[X0] - half), io[X0] + half)
    io[MEAN] += s[0] - io[X0]


def _gap_law(p, s, io):  # type: ignore[no-untyped-def]
    """p: gap, stiffness and damping of the coupling; s: start and end force.

    The plant holds the coupling as spring and damper; this force takes away what the gap takes:
    all of it within the gap, stiffness * gap/2 beyond it.
    """
    half = 0.5 * p[0]
    if io[FIRST] != 0.0:
        free = io[X0] > -half and io[X0] < half
        s[0] = p[1] * min(max(io[X0], -half), half) + (p[2] * io[V0] if free else 0.0)
    xa, gx, va, gv = end_motion(io, s[0])
    # Three straight pieces of one monotone relation: take the piece that holds its own root.
    force = (p[1] * xa + p[2] * va) / (1.0 - p[1] * gx - p[2] * gv)
    x1 = xa + gx * force
    if x1 >= half:
        force = p[1] * half
    elif x1 <= -half:
        force = -p[1] * half
    s[1] = force
    set_line(io, s[0], force)


class Backlash(Effect):
    """Key `kind` = "play": y follows the motor's position with a play of total width `gap` (the
    load keeps its place within it). `kind` = "coupling": in a plant with a mode, the spring between
    motor and load has a dead zone of total width `gap`. Default: "coupling" where the plant has a
    mode beside its rigid body, else "play"."""

    name = "backlash"
    component = "transmission"
    parameters = (Parameter("gap", "x"),)
    options = {"kind": ("play", "coupling")}  # noqa: RUF012
    sides = ("sensor",)
    depends_on = ("direction", "history")
    siblings = ("hysteresis", "coulomb_friction", "dead_zone", "presliding_friction")
    port = "output"

    def kind_in(self, setting: Setting) -> str:
        flexible = len(setting.mechanics.modes) > 1
        return str(setting.options.get("kind", "coupling" if flexible else "play"))

    def port_in(self, setting: Setting) -> str:
        return "output" if self.kind_in(setting) == "play" else "force"

    def law_in(self, setting: Setting) -> Law:
        return _play_law if self.kind_in(setting) == "play" else _gap_law

    def side_in(self, setting: Setting) -> str:
        return "sensor" if self.kind_in(setting) == "play" else "coupling"

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        if self.kind_in(setting) == "play":
            return [values["gap"]]
        self.require(
            len(setting.mechanics.modes) > 1,
            'kind = "coupling" needs a plant with a mode; take kind = "play" or add flexible_mode',
        )
        mobility, mode = setting.point("coupling").mobility, setting.mechanics.modes[1]
        return [values["gap"], mode.stiffness / mobility, mode.damping / mobility]

    def initial_state(self, packed, step):  # type: ignore[no-untyped-def]
        return [0.0, 0.0]

    def stiffness(self, packed):  # type: ignore[no-untyped-def]
        return packed[1] if len(packed) > 1 else 0.0

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"shape": float(g)} for g in motion.span * np.geomspace(1e-5, 0.1, 9)]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """(play - x)/gap in the shape it has at the gap `shape`; its coefficient is the gap."""
        shape = nonlinear["shape"]
        return np.column_stack([(play(motion.x, shape) - motion.x) / shape])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return {"gap": max(float(coefficients[0]), 0.0)}

    def says(self, values: Parameters, plant: Plant) -> str:
        return (
            f"Motor and load have a play of {self.quantity(values, 'gap', plant)} between them "
            "(backlash)."
        )
