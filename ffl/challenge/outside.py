"""Physics that the catalogue does not have: the right answer is `unnamed`, with what it hangs on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffl.challenge import kernel
from ffl.challenge.physics import Make


def eddy_brake(build, rng, scales, at, size):
    """Eddy-current brake: drag that peaks at a low speed and falls beyond it."""
    speed = rng.uniform(0.1, 0.2) * scales.speed
    peak = size * rng.uniform(0.06, 0.15) * scales.force
    build.add(kernel.EDDY, build.port(at), 2 * peak / speed, speed)
    return {"peak_force": peak, "speed": speed}


def amplifier_asymmetry(build, rng, scales, at, size):
    """Gain of the amplifier larger in one direction than in the other."""
    share = size * rng.uniform(0.03, 0.1) * rng.choice([-1, 1])
    build.actuator[kernel.ASYMMETRY] = share
    return {"share": share}


def hot_motor(build, rng, scales, at, size):
    """Motor constant that fades as the winding warms with the square of the current."""
    fade = min(size * rng.uniform(0.1, 0.25), 0.6)
    time_constant = scales.duration * rng.uniform(0.2, 0.6)
    build.actuator[[kernel.FADE, kernel.FADE_TIME, kernel.FADE_HEAT]] = (
        fade,
        time_constant,
        1.0 / np.mean(scales.command_levels**2),
    )
    return {"fade": fade, "time_constant": time_constant}


def warm_guide(build, rng, scales, at, size):
    """A guide that warms with the motor's loss (current squared) and pushes."""
    amplitude = size * rng.uniform(0.05, 0.15) * scales.force * rng.choice([-1, 1])
    time_constant = scales.duration * rng.uniform(0.1, 0.4)
    heat = 1.0 / np.mean(scales.command_levels**2)
    build.add(kernel.THERMAL, build.port(at), amplitude, time_constant, heat, 1.0)
    return {"amplitude": amplitude, "time_constant": time_constant}


def magnet(build, rng, scales, at, size):
    """A magnet beside the track: a force over a short piece of the stroke."""
    amplitude = size * rng.uniform(0.06, 0.15) * scales.force * rng.choice([-1, 1])
    centre = scales.low + rng.uniform(0.25, 0.75) * scales.stroke
    width = rng.uniform(0.03, 0.08) * scales.stroke
    build.add(kernel.BUMP, build.port(at), amplitude, centre, width)
    return {"amplitude": amplitude, "centre": centre, "width": width}


def end_stop(build, rng, scales, at, size):
    """A rubber stop that the last part of the stroke runs into."""
    depth = rng.uniform(0.15, 0.3) * scales.stroke
    stiffness = size * rng.uniform(0.1, 0.25) * scales.force / depth
    build.add(kernel.END_STOP, build.port(at), stiffness, scales.high - depth, 1.0)
    return {"stiffness": stiffness, "begins": scales.high - depth}


def gain_ripple(build, rng, scales, at, size):
    """Commutation: the motor constant itself ripples with position."""
    ripple = size * rng.uniform(0.04, 0.12)
    period, phase = scales.stroke * rng.uniform(0.08, 0.25), rng.uniform(-np.pi, np.pi)
    build.actuator[[kernel.RIPPLE, kernel.RIPPLE_PERIOD, kernel.RIPPLE_PHASE]] = (
        ripple,
        period,
        phase,
    )
    return {"ripple": ripple, "period": period, "phase": phase}


def load_dependent_friction(build, rng, scales, at, size):
    """Gear friction in proportion to the transmitted force."""
    share = size * rng.uniform(0.05, 0.15)
    build.add_dry(build.port(at), 0.0, 0.0, share=share)
    return {"share": share}


def position_inertia(build, rng, scales, at, size):
    """Inertia that depends on position, as a crank has it."""
    share = min(size * rng.uniform(0.06, 0.15), 0.4)
    mass = share * build.body.moving_mass
    period = scales.stroke * rng.uniform(0.4, 0.9)
    phase = rng.uniform(-np.pi, np.pi)
    build.add(kernel.INERTIA, build.port(at), mass, period, phase)
    return {"share": share, "period": period, "phase": phase}


def creep(build, rng, scales, at, size):
    """A viscoelastic cable: a spring whose force fades (Maxwell element)."""
    time_constant = rng.uniform(0.1, 0.4)
    stiffness = size * rng.uniform(0.1, 0.3) * scales.force / scales.stroke
    build.add(kernel.RELAXATION, build.port(at), stiffness, time_constant)
    return {"stiffness": stiffness, "time_constant": time_constant}


def back_emf_limit(build, rng, scales, at, size):
    """Supply voltage: the force left falls with speed."""
    share = np.clip(0.97 - 0.03 * size, 0.75, 0.99)
    limit = float(np.interp(share, np.linspace(0, 1, 101), scales.command_levels)) * 1.15
    fall = limit * rng.uniform(0.35, 0.6) / scales.speed
    build.actuator[[kernel.LIMIT, kernel.BACK_EMF]] = limit, fall
    return {"limit": limit, "fall": fall}


def knocks(build, rng, scales, at, size):
    """Somebody knocks against the machine at random times."""
    force = size * rng.uniform(0.05, 0.15) * scales.force
    build.knocks.append((rng.uniform(0.6, 1.5), force, rng.uniform(0.02, 0.08)))
    return {"force": force}


def lost_commands(build, rng, scales, at, size):
    """A fieldbus that loses packets: the drive keeps the previous command."""
    build.loss = min(size * rng.uniform(0.02, 0.08), 0.3)
    return {"probability": build.loss}


def sensor_curvature(build, rng, scales, at, size):
    """A position sensor whose scale is bent: y = x + c x^2."""
    curvature = size * rng.uniform(0.003, 0.01) / max(abs(scales.low), abs(scales.high))
    curvature *= rng.choice([-1, 1])
    build.sensor[kernel.CURVATURE] = curvature
    return {"curvature": curvature}


@dataclass(frozen=True)
class Stranger:
    """An effect outside the catalogue, its component and what it depends on."""

    make: Make
    component: str
    depends_on: tuple[str, ...]


OUTSIDE: dict[str, Stranger] = {
    "eddy_brake": Stranger(eddy_brake, "plant", ("velocity",)),
    "amplifier_asymmetry": Stranger(amplifier_asymmetry, "actuator", ("command",)),
    "hot_motor": Stranger(hot_motor, "actuator", ("command", "time", "temperature", "history")),
    "warm_guide": Stranger(
        warm_guide, "environment", ("command", "time", "temperature", "history")
    ),
    "magnet": Stranger(magnet, "plant", ("position",)),
    "end_stop": Stranger(end_stop, "environment", ("position",)),
    "gain_ripple": Stranger(gain_ripple, "actuator", ("command", "position")),
    "load_dependent_friction": Stranger(
        load_dependent_friction, "plant", ("command", "direction", "acceleration")
    ),
    "position_inertia": Stranger(position_inertia, "plant", ("position", "acceleration")),
    "creep": Stranger(creep, "plant", ("history", "position", "velocity")),
    "back_emf_limit": Stranger(back_emf_limit, "actuator", ("command", "velocity")),
    "knocks": Stranger(knocks, "environment", ("time",)),
    "lost_commands": Stranger(lost_commands, "timing", ("time", "command")),
    "sensor_curvature": Stranger(sensor_curvature, "sensor", ("position",)),
}
