"""An independent simulation for the tests: a rigid mass, continuous in time, adaptive Runge-Kutta.

Nothing of `ffl.machines` or `ffl.effects` is used. Between samples the command is held; smooth
forces and internal states are integrated by DOP853 to 1e-11 (stiff ones by LSODA), dry friction
switches at located events of the velocity. The controller runs once per sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

SAMPLE_TIME = 1e-3
MASS = 2.0


def lead(error: float, state: float) -> tuple[float, float]:
    """4000 (z - 0.98)/(z - 0.8): command and next state."""
    return 4000.0 * (error + state), 0.8 * (error + state) - 0.98 * error


@dataclass
class Case:
    """Physics of one effect, by plain functions of time t, position x, velocity v, state z.

    `force(t, x, v, z)`; `rate(x, v, z)` of the internal states; `levels(x, v)` (plus, minus) of dry
    friction; `command(t, history)` the force at time t from the commands so far; `sense(x, memory)` in
    every sample, `turn(x, memory)` wherever the motion turns between two of them.
    """

    force: Callable = lambda t, x, v, z: 0.0
    rate: Callable = lambda x, v, z: ()
    levels: Callable | None = None
    drive: Callable = lambda u, x, z: u
    drive_rate: Callable | None = None
    sense: Callable = lambda x, memory: x
    turn: Callable | None = None
    states: int = 0
    split: float = 0.0  # fraction of the sample after which the command of `late` samples ago ends
    late: int = 0
    method: str = "DOP853"


def run(case: Case, reference: np.ndarray, closed: bool = True) -> np.ndarray:
    """y of the mass under `case`, sample by sample."""
    n = len(reference)
    y, u = np.zeros(n), np.zeros(n + 1)
    state, memory, control = np.zeros(2 + case.states), {}, 0.0
    stuck = True
    for k in range(n):
        memory["v"] = state[1]
        y[k] = case.sense(state[0], memory)
        u[k], control = lead(reference[k] - y[k], control) if closed else (reference[k], 0.0)
        pieces = [(0.0, 1.0, case.late)]
        if case.split > 0:
            pieces = [(0.0, case.split, case.late + 1), (case.split, 1.0, case.late)]
        for begin, end, late in pieces:
            command = u[k - late] if k >= late else 0.0
            span = ((k + begin) * SAMPLE_TIME, (k + end) * SAMPLE_TIME)
            state, stuck = _advance(case, command, span, state, stuck, memory)
    return y


def _advance(case, command, span, state, stuck, memory):
    (t, end), broken = span, False

    def others(t, s):
        return case.drive(command, s[0], s[2:]) + case.force(t, s[0], s[1], s[2:])

    while t < end - 1e-15:
        if case.levels is None:
            direction = None
        else:
            plus, minus = case.levels(state[0], 0.0)
            pull = others(t, state)
            if state[1] != 0 and not stuck:
                direction = np.sign(state[1])
            elif pull > plus or (broken and pull > 0):
                direction = 1.0
            elif pull < -minus or broken:
                direction = -1.0
            else:
                direction = 0.0

        def slope(t, s, direction=direction):
            rates = list(case.rate(s[0], s[1], s[2:]))
            if case.drive_rate is not None:
                rates += list(case.drive_rate(command, s[2:]))
            if direction == 0.0:
                return [0.0, 0.0, *rates]
            total = others(t, s)
            if direction is not None:
                plus, minus = case.levels(s[0], s[1])
                total -= plus if direction > 0 else -minus
            return [s[1], total / MASS, *rates]

        events = None
        if direction == 0.0:
            plus, minus = case.levels(state[0], 0.0)

            def breaks(t, s, plus=plus, minus=minus):
                pull = others(t, s)
                return min(plus - pull, pull + minus)

            breaks.terminal, breaks.direction = True, -1
            events = breaks
        elif direction is not None:

            def stops(t, s):
                return s[1]

            stops.terminal, stops.direction = True, -direction
            events = stops
        elif case.turn is not None:

            def turns(t, s):
                return s[1]

            events = turns
        solution = solve_ivp(
            slope, (t, end), state, method=case.method, rtol=1e-11, atol=1e-15, events=events
        )
        assert solution.success
        if direction is None and case.turn is not None:
            for turned in solution.y_events[0]:
                case.turn(turned[0], memory)
        state, t = solution.y[:, -1].copy(), float(solution.t[-1])
        stuck = direction == 0.0
        broken = stuck and solution.status == 1
        if solution.status == 1 and not stuck:
            state[1], stuck = 0.0, True
    return state, stuck
