"""Two masses on a spring, and their independent simulation (adaptive, in continuous time)."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from scipy.integrate import solve_ivp

from ffl.systems.loop import Controller
from ffl.systems.plant import Plant
from ffl.systems.state_space import StateSpace
from ffl.systems.zpk import Zpk

SAMPLE_TIME = 1e-3
MOTOR, LOAD = 1.2, 0.8
FREQUENCY, DAMPING = 60.0, 0.02  # free resonance of the pair
REDUCED = MOTOR * LOAD / (MOTOR + LOAD)
SPRING = (2 * np.pi * FREQUENCY) ** 2 * REDUCED
DAMPER = 2 * DAMPING * 2 * np.pi * FREQUENCY * REDUCED


def matrices(motor=MOTOR, load=LOAD, guide=0.0, ground=None):
    """States x_motor, v_motor, x_load, v_load; `guide` rubs on the motor, `ground` are springs."""
    k, c = SPRING, DAMPER
    held = {"motor": 0.0, "load": 0.0, **(ground or {})}
    a = np.array(
        [
            [0, 1, 0, 0],
            [-(k + held["motor"]) / motor, -(c + guide) / motor, k / motor, c / motor],
            [0, 0, 0, 1],
            [k / load, c / load, -(k + held["load"]) / load, -c / load],
        ]
    )
    return a, np.array([0, 1 / motor, 0, 0])


def two_mass_plant(
    measured: str = "motor", motor=MOTOR, load=LOAD, guide=0.0, ground=None
) -> Plant:
    """ZOH plant under the lead controller of the rigid stage, turned down for the load side."""
    a, b = matrices(motor, load, guide, ground)
    block = np.zeros((5, 5))
    block[:4, :4], block[:4, 4] = a, b
    exponential = scipy.linalg.expm(block * SAMPLE_TIME)
    c = [1.0, 0, 0, 0] if measured == "motor" else [0, 0, 1.0, 0]
    gain = 4000.0 if measured == "motor" else 100.0
    system = StateSpace(exponential[:4, :4], exponential[:4, 4:], c, 0.0, SAMPLE_TIME)
    lead = Controller.of_error(Zpk([0.98], [0.8], gain, SAMPLE_TIME))
    return Plant(f"two_mass_{measured}", system, lead, "N", "m")


def simulate(force, command, friction_side=None, level=0.0):
    """Positions (N, 2) of motor and load under a held command, with `force(t, state)` = (on motor,
    on load) and dry friction on one side, by DOP853 with events."""
    a, b = matrices()
    masses = np.array([MOTOR, LOAD])
    side = None if friction_side is None else ("motor", "load").index(friction_side)
    positions, state, stuck = np.zeros((len(command), 2)), np.zeros(4), True

    for k, u in enumerate(command):
        positions[k] = state[[0, 2]]
        t, end, broken = k * SAMPLE_TIME, (k + 1) * SAMPLE_TIME, False

        def free(t, s, u=u):
            slope = a @ s + b * u
            slope[[1, 3]] += np.asarray(force(t, s)) / masses
            return slope

        while t < end - 1e-15:
            direction = None
            if side is not None:
                v, pull = state[1 + 2 * side], free(t, state)[1 + 2 * side] * masses[side]
                breaks = broken or abs(pull) > level
                direction = np.sign(v) if not stuck else np.sign(pull) * breaks

            def slope(t, s, direction=direction):
                rates = free(t, s)
                if direction is not None:
                    held = rates[1 + 2 * side] if direction == 0 else 0.0
                    rates[1 + 2 * side] -= held + direction * level / masses[side]
                    if direction == 0:
                        rates[2 * side] = 0.0
                return rates

            events = None
            if direction == 0:

                def events(t, s):
                    return level - abs(free(t, s)[1 + 2 * side]) * masses[side]

                events.terminal, events.direction = True, -1
            elif direction is not None:

                def events(t, s):
                    return s[1 + 2 * side]

                events.terminal, events.direction = True, -direction
            done = solve_ivp(
                slope, (t, end), state, method="DOP853", rtol=1e-10, atol=1e-14, events=events
            )
            state, t = done.y[:, -1].copy(), float(done.t[-1])
            stuck = direction == 0
            broken = stuck and done.status == 1
            if done.status == 1 and not stuck:
                state[1 + 2 * side], stuck = 0.0, True
    return positions
