"""The closed loop: u = C_r r - C_y y + f, y = P (u + w) + v."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ffl.errors import InputError
from ffl.systems.margins import Margins, margins_of
from ffl.systems.state_space import Array, ComplexArray, StateSpace, without_unseen
from ffl.systems.zpk import Zpk, as_state_space

SLOWEST = 1e-8  # of Nyquist's frequency: a slower pole is an integrator, but for rounding


@dataclass(frozen=True)
class Controller:
    """u_fb = C_r r - C_y y. `one_degree` controllers act on r - y and share their states; others share
    those of their common integrators, which neither could keep from growing by itself."""

    reference: Zpk | StateSpace
    output: Zpk | StateSpace

    @classmethod
    def of_error(cls, system: Zpk | StateSpace) -> Controller:
        """u_fb = C (r - y)."""
        return cls(system, system)

    @property
    def one_degree(self) -> bool:
        return self.reference is self.output

    @cached_property
    def state_space(self) -> StateSpace:
        """Inputs (r, y), output u_fb; one set of states where r and y are treated alike."""
        cr = as_state_space(self.reference)
        if self.one_degree:
            return StateSpace(
                cr.a, np.hstack([cr.b, -cr.b]), cr.c, np.hstack([cr.d, -cr.d]), cr.sample_time
            )
        cy = as_state_space(self.output)
        zero = np.zeros((cr.order, cy.order))
        a = np.block([[cr.a, zero], [zero.T, cy.a]])
        b = np.block([[cr.b, np.zeros_like(cr.b)], [np.zeros_like(cy.b), -cy.b]])
        c, d = np.hstack([cr.c, cy.c]), np.hstack([cr.d, -cy.d])
        return StateSpace(*without_unseen(a, b, c, 1.0), d, cr.sample_time)


@dataclass(frozen=True)
class Loop:
    """Closed loop of `plant` and `controller` (None: open loop, u = f).

    `system` has inputs (r, f, w, v): reference, feedforward, force disturbance (input units, beside
    u), sensor noise; outputs (y, u): measured output and command.
    """

    plant: Zpk | StateSpace
    controller: Controller | None
    system: StateSpace

    @cached_property
    def poles(self) -> ComplexArray:
        """Closed-loop poles: eigenvalues of the assembled state matrix, never polynomial roots."""
        return self.system.poles

    @property
    def is_stable(self) -> bool:
        return self.system.is_stable

    @cached_property
    def sensitivity(self) -> StateSpace:
        """S = 1/(1 + P C_y): sensor noise v to measured output."""
        return self.system.select([0], [3])

    @cached_property
    def process_sensitivity(self) -> StateSpace:
        """SP = P/(1 + P C_y): feedforward f to output y."""
        return self.system.select([0], [1])

    @cached_property
    def reference_to_output(self) -> StateSpace:
        return self.system.select([0], [0])

    def margins(self, n_frequencies: int = 20000) -> Margins:
        """Margins of the loop gain L = P C_y, found on a logarithmic grid of `n_frequencies` up to Nyquist,
        from 1e-5 of it on or from a decade below the slowest pole of the closed loop, if that is lower,
        and refined between its points."""
        if self.controller is None:
            return Margins(np.inf, np.inf, 1.0, 0.0)
        plant, output = self.plant, self.controller.output
        nyquist = 0.5 / self.system.sample_time
        slowest = float(
            np.abs(np.log(self.system.poles[self.system.poles != 0.0])).min(initial=np.pi)
        )
        lowest = min(1e-5, 0.1 * max(slowest / np.pi, SLOWEST))
        f = np.geomspace(nyquist * lowest, nyquist * 0.9999, n_frequencies)
        ends = np.array([0.0, nyquist])
        with np.errstate(all="ignore"):
            at_ends = np.concatenate(
                [_or_none(plant, z) * _or_none(output, z) for z in (1.0, -1.0)]
            )
        return margins_of(lambda x: plant.response(x) * output.response(x), f, (ends, at_ends))


def _or_none(system: Zpk | StateSpace, z: float) -> ComplexArray:
    """The response at `z`, NaN on a pole."""
    try:
        return np.atleast_1d(system.at(np.array([z])))
    except (np.linalg.LinAlgError, ZeroDivisionError):
        return np.array([np.nan], complex)


def closed_loop(plant: Zpk | StateSpace, controller: Controller | None) -> Loop:
    """Closes the loop in state space.

    Raises `InputError` where plant and controller both react within the same sample with gain -1.
    """
    p = as_state_space(plant)
    if controller is None:
        c = StateSpace(
            np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[0.0, 0.0]], p.sample_time
        )
    else:
        c = controller.state_space
        if abs(c.sample_time - p.sample_time) > 1e-9 * p.sample_time:
            raise InputError(
                f"controller sample_time {c.sample_time} differs from the plant's {p.sample_time}"
            )
    dp, dy, dr = p.d[0, 0], -c.d[0, 1], c.d[0, 0]
    if abs(1.0 + dp * dy) < 1e-12:
        raise InputError(
            "algebraic loop: plant and controller feedthrough give 1 + D_p D_c = 0; add a delay"
        )
    k = 1.0 / (1.0 + dp * dy)
    n, m = p.order, c.order
    # u and y as functions of the states (x_p, x_c) and of the inputs (r, f, w, v).
    u_states: Array = k * np.concatenate([-dy * p.c[0], c.c[0]])
    u_inputs: Array = k * np.array([dr, 1.0, -dy * dp, -dy])
    y_states = dp * u_states + np.concatenate([p.c[0], np.zeros(m)])
    y_inputs = dp * (u_inputs + np.array([0.0, 0.0, 1.0, 0.0])) + np.array([0.0, 0.0, 0.0, 1.0])
    force = np.array([0.0, 0.0, 1.0, 0.0])
    reference = np.array([1.0, 0.0, 0.0, 0.0])
    a = np.zeros((n + m, n + m))
    a[:n, :n] = p.a
    a[n:, n:] = c.a
    a[:n] += p.b @ u_states[None, :]
    a[n:] += c.b[:, 1:2] @ y_states[None, :]
    b = np.vstack(
        [
            p.b @ (u_inputs + force)[None, :],
            c.b[:, 0:1] @ reference[None, :] + c.b[:, 1:2] @ y_inputs[None, :],
        ]
    )
    system = StateSpace(
        a, b, np.vstack([y_states, u_states]), np.vstack([y_inputs, u_inputs]), p.sample_time
    )
    return Loop(plant, controller, system)
