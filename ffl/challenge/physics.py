"""The catalogue's effects as the challenge makes them, other forms of physics where possible.

Each function takes the machine under construction, a generator, the sizes of its motion, the
point where the effect acts and a factor on its size; it adds the physics and returns the
parameters in the catalogue's terms (forces in N).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ffl.challenge import kernel
from ffl.challenge.build import N_GRID, Build, Draws, Scales

Make = Callable[[Build, Draws, Scales, str, float], dict]


def coulomb_friction(build, rng, scales, at, size):
    """Set-valued dry friction, 3 to 15 % of the peak force."""
    level = size * rng.uniform(0.03, 0.15) * scales.force
    build.add_dry(build.port(at), level, level)
    return {"level": level}


def asymmetric_friction(build, rng, scales, at, size):
    """Set-valued dry friction with unequal levels."""
    mean = size * rng.uniform(0.04, 0.15) * scales.force
    skew = rng.uniform(0.15, 0.4) * rng.choice([-1, 1])
    up, down = mean * (1 + skew), mean * (1 - skew)
    build.add_dry(build.port(at), up, down)
    return {"level_positive": up, "level_negative": down}


def viscous_friction(build, rng, scales, at, size):
    """More of the guide's damping, in the damping matrix."""
    coefficient = size * rng.uniform(0.05, 0.2) * scales.force / scales.speed
    # Below 2 % of the RMS force it would be a correction of the model's damping.
    coefficient = max(coefficient, 0.04 * scales.force_rms / scales.speed_rms)
    p = build.ports[build.port(at)]
    build.damping += coefficient * np.outer(p, p)
    return {"coefficient": coefficient}


def stribeck_friction(build, rng, scales, at, size):
    """Set-valued dry friction whose level falls with speed."""
    coulomb = size * rng.uniform(0.03, 0.1) * scales.force
    ratio = rng.uniform(0.4, 1.2)
    speed = rng.uniform(0.03, 0.12) * scales.speed
    build.add_dry(build.port(at), coulomb, coulomb, ratio, speed)
    return {
        "coulomb_level": coulomb,
        "static_level": coulomb * (1 + ratio),
        "stribeck_velocity": speed,
    }


def presliding_friction(build, rng, scales, at, size):
    """Generalised Maxwell slip: 8 elastic-slip elements in parallel.

    Their virgin curve follows level (1 - exp(-stiffness x / level)), LuGre's, at the nodes; on
    return it obeys Masing's rule, which LuGre does not.
    """
    level = size * rng.uniform(0.05, 0.15) * scales.force
    reach = (
        np.exp(rng.uniform(np.log(0.0007), np.log(0.01))) * scales.stroke
    )  # displacement to 63 % of the level
    stiffness, micro = level / reach, rng.uniform(0.05, 0.3) * level / scales.speed
    n = 8
    nodes = reach * np.array([0.15, 0.35, 0.6, 0.9, 1.3, 1.8, 2.6, 4.5])
    curve = level * (1 - np.exp(-nodes / reach))
    curve *= level / curve[-1]
    slopes = np.append(np.diff(np.append(0.0, curve)) / np.diff(np.append(0.0, nodes)), 0.0)
    springs = slopes[:-1] - slopes[1:]
    pairs = [v for j in range(n) for v in (springs[j], nodes[j])]
    build.add(kernel.SLIP, build.port(at), micro, *pairs)
    return {"level": level, "stiffness": stiffness, "micro_damping": micro}


def position_dependent_friction(build, rng, scales, at, size):
    """Dry friction read from two tables over position, one per direction."""
    level = size * rng.uniform(0.05, 0.15) * scales.force
    margin = 0.05 * scales.stroke
    grid = np.linspace(scales.low - margin, scales.high + margin, N_GRID)
    rows = []
    shared = rng.uniform(0, 2 * np.pi)
    for _ in range(2):
        x = (grid - scales.low) / scales.stroke
        wave = rng.uniform(0.25, 0.5) * np.sin(2 * np.pi * rng.uniform(0.7, 1.6) * x + shared)
        tilt = rng.uniform(-0.3, 0.3) * (x - 0.5)
        rows.append(level * (1 + wave + tilt))
    mean = float(np.mean(rows))
    build.tables.append(np.concatenate([[grid[0], grid[-1]], *rows]))
    build.add_dry(build.port(at), level, level, table=len(build.tables) - 1)
    return {
        "level": mean,
        "table": {
            "grid": grid.tolist(),
            "positive": rows[0].tolist(),
            "negative": rows[1].tolist(),
        },
    }


def constant_load(build, rng, scales, at, size):
    """A weight over a pulley, or gravity on a slope."""
    force = size * rng.uniform(0.04, 0.15) * scales.force * rng.choice([-1, 1])
    build.add(kernel.CONSTANT, build.port(at), force)
    return {"force": force}


def cogging(build, rng, scales, at, size):
    """Reluctance force of the magnet track with its second harmonic."""
    amplitude = size * rng.uniform(0.03, 0.08) * scales.force
    period = scales.stroke * rng.uniform(0.06, 0.25)
    phase, phase_2 = rng.uniform(-np.pi, np.pi, 2)
    second = amplitude * rng.choice([0.0, rng.uniform(0.1, 0.35)])
    build.add(kernel.SINE_OF_POSITION, 0, amplitude, period, phase, second, phase_2)
    out = {"amplitude": amplitude, "period": period, "phase": phase}
    return out | ({"amplitude_2": second, "phase_2": phase_2} if second else {})


def linear_stiffness(build, rng, scales, at, size):
    """A cable chain's spring."""
    stiffness = size * rng.uniform(0.06, 0.2) * scales.force / scales.stroke
    stiffness = max(stiffness, 0.15 * scales.force_rms / scales.stroke)
    centre = scales.low + rng.uniform(0.2, 0.8) * scales.stroke
    build.add(kernel.SPRING, build.port(at), stiffness, 0.0, centre)
    return {"stiffness": stiffness, "centre": centre}


def hardening_spring(build, rng, scales, at, size):
    """A membrane's cubic spring."""
    cubic = size * rng.uniform(0.08, 0.25) * scales.force / (0.6 * scales.stroke) ** 3
    centre = scales.low + rng.uniform(0.3, 0.7) * scales.stroke
    build.add(kernel.SPRING, build.port(at), 0.0, cubic, centre)
    return {"cubic_coefficient": cubic, "centre": centre}


def position_dependent_gain(build, rng, scales, at, size):
    """Motor constant that falls towards the ends of the track."""
    centre = scales.low + rng.uniform(0.3, 0.7) * scales.stroke
    drop = size * rng.uniform(0.05, 0.15)
    a = rng.choice([-1, 1]) * drop * rng.uniform(0.3, 1.0) / scales.stroke
    b = -drop / (0.5 * scales.stroke) ** 2
    build.actuator[[kernel.GAIN_1, kernel.GAIN_2, kernel.GAIN_CENTRE]] = a, b, centre
    return {"linear_coefficient": a, "quadratic_coefficient": b, "centre": centre}


def quadratic_drag(build, rng, scales, at, size):
    """Air or liquid drag."""
    coefficient = size * rng.uniform(0.06, 0.2) * scales.force / scales.speed**2
    build.add(kernel.DRAG, build.port(at), coefficient)
    return {"coefficient": coefficient}


def backlash(build, rng, scales, at, size):
    """A compliant gap that is driven: in the spring of a two-mass machine, before a split-off
    load on others; or (printer, stiffness-driven, 2018 loop) play of the measuring head."""
    gap = size * rng.uniform(0.002, 0.006) * scales.stroke
    body = build.body
    if at == "output":
        build.sensor[kernel.PLAY] = gap
        return {"gap": gap}
    if len(body.motor) == 2:
        stiffness, damping = -body.stiffness[0, 1], -body.damping[0, 1]
        pull = np.array([[1.0, -1.0], [-1.0, 1.0]])
        build.stiffness -= stiffness * pull
        build.damping -= damping * pull
        # Gear teeth in oil: 4 % in the mesh keep the load from rattling for ever.
        reduced = np.prod(np.diag(body.mass)) / body.moving_mass
        damping = max(damping, 0.08 * np.sqrt(stiffness * reduced))
        port = build.add_port([1.0, -1.0])
    else:
        share = rng.uniform(0.25, 0.5)
        load = share * body.moving_mass
        new = build.add_mass()
        build.mass[0, 0] -= load
        build.mass[new, new] = load
        reduced = load * (1 - share)
        w = 2 * np.pi * rng.uniform(120.0, 200.0)
        stiffness, damping = w**2 * reduced, 0.4 * w * reduced
        direction = np.zeros(new + 1)
        direction[[0, new]] = 1.0, -1.0
        port = build.add_port(direction)
    build.add(kernel.GAP, port, gap, stiffness, damping)
    return {"gap": gap}


def hysteresis(build, rng, scales, at, size):
    """Bouc-Wen hysteresis with its own integrator (implicit midpoint in displacement)."""
    force = size * rng.uniform(0.06, 0.15) * scales.force
    displacement = rng.uniform(0.05, 0.2) * scales.stroke
    exponent, beta = rng.choice([1.0, 1.5, 2.0]), rng.uniform(0.5, 0.8)
    build.add(kernel.BOUC_WEN, build.port(at), force, displacement, exponent, beta)
    return {"force": force, "displacement": displacement, "exponent": exponent, "beta": beta}


def saturation(build, rng, scales, at, size):
    """The amplifier's current limit, at a high quantile of the command."""
    share = np.clip(0.955 - 0.06 * size * rng.uniform(0.5, 1.0), 0.6, 0.985)
    limit = float(np.interp(share, np.linspace(0, 1, 101), scales.command_levels))
    build.actuator[kernel.LIMIT] = limit
    return {"limit": limit}


def dead_zone(build, rng, scales, at, size):
    """Cross-over of a class-B amplifier."""
    half = size * rng.uniform(0.02, 0.08) * scales.command
    build.actuator[kernel.DEAD] = half
    return {"half_width": half}


def input_delay(build, rng, scales, at, size):
    """Transport of the command over a fieldbus, a fraction of a sample too."""
    late = max(size * rng.uniform(0.5, 2.5), 0.15) * scales.sample_time
    steps = round(late / scales.quantum)
    build.actuator[kernel.DELAY] = steps
    return {"delay": steps * scales.quantum}


def actuator_lag(build, rng, scales, at, size):
    """First-order current loop."""
    time_constant = max(size * rng.uniform(0.6, 3.0), 0.15) * scales.sample_time
    build.actuator[kernel.LAG] = time_constant
    return {"time_constant": time_constant}


def _room(build, p):
    """Share of the moving mass that can be taken from point p before the mass matrix fails."""
    return 1.0 / (build.body.moving_mass * (p @ np.linalg.solve(build.mass, p)))


# Uniform cantilever: frequencies relative to the first, effective modal masses over its mass.
_BEAM = ((1.0, 0.613), (6.267, 0.188))


def flexible_mode(build, rng, scales, at, size):
    """A cantilever beam on the moving mass, two of its modes; its first one is the truth."""
    body = build.body
    p = build.ports[build.port(at)].copy()
    fraction = min(size * rng.uniform(0.04, 0.12), 0.2, 0.4 * _room(build, p))
    top = 0.25 / scales.sample_time
    clamped = (
        rng.uniform(12.0, min(60.0, 0.4 * top))
        if len(body.motor) == 1
        else rng.uniform(90.0, min(160.0, 0.9 * top))
    )
    if body.stiffness[0, 0] > 0 and len(body.motor) == 1:
        own = np.sqrt(body.stiffness[0, 0] / body.mass[0, 0]) / (2 * np.pi)
        clamped = own * rng.uniform(1.5, 2.5)
    damping = rng.uniform(0.008, 0.03)
    for ratio, effective in _BEAM:
        part = fraction / _BEAM[0][1] * effective * body.moving_mass
        w = 2 * np.pi * clamped * ratio
        n = build.add_mass()
        p = np.append(p, 0.0)
        tie = p.copy()
        tie[n] = -1.0
        build.mass -= part * np.outer(p, p)
        build.mass[n, n] = part
        build.stiffness += w**2 * part * np.outer(tie, tie)
        build.damping += 2 * damping * w * part * np.outer(tie, tie)
    poles = np.linalg.eigvals(
        np.block(
            [
                [np.zeros_like(build.mass), np.eye(len(build.mass))],
                [
                    -np.linalg.solve(build.mass, build.stiffness),
                    -np.linalg.solve(build.mass, build.damping),
                ],
            ]
        )
    )
    # The resonance of the whole that the beam's first mode became.
    clamped_w = 2 * np.pi * clamped
    candidates = [s for s in poles if s.imag > clamped_w * 0.98]
    s = min(candidates, key=lambda v: abs(abs(v) - clamped_w * np.sqrt(1 / (1 - fraction))))
    return {
        "frequency": float(abs(s) / (2 * np.pi)),
        "damping": float(-s.real / abs(s)),
        "mass_fraction": fraction,
    }


def mass_change(build, rng, scales, at, size):
    """A payload nobody told the model of, or one that is not there."""
    change = max(size * rng.uniform(0.04, 0.12), 0.03) * rng.choice([-1, 1])
    p = build.ports[build.port(at)]
    change = float(np.clip(change, -0.5 * _room(build, p), 0.5))
    build.mass += change * build.body.moving_mass * np.outer(p, p)
    return {"change": change}


def encoder_ripple(build, rng, scales, at, size):
    """Sine and cosine tracks with offsets, read by arctangent."""
    period = scales.stroke * rng.uniform(0.02, 0.12)
    offset = min(size * rng.uniform(0.004, 0.02), 0.2)
    amplitude = offset * period / (2 * np.pi)
    phase = rng.uniform(-np.pi, np.pi)
    build.sensor[[kernel.OFFSET_SIN, kernel.OFFSET_COS, kernel.PITCH]] = (
        offset * np.sin(phase),
        -offset * np.cos(phase),
        period,
    )
    return {"amplitude": amplitude, "period": period, "phase": phase}


def sensor_nonlinearity(build, rng, scales, at, size):
    """A sensor at its end, or one that is blind to the sign."""
    if rng.random() < 0.6 or scales.low > -0.15 * scales.stroke:
        level = (0.93 - 0.2 * rng.random()) * max(abs(scales.low), abs(scales.high))
        build.sensor[kernel.CLIP] = level
        return {"kind": "clipping", "level": level}
    build.sensor[kernel.RECTIFY] = 1.0
    return {"kind": "rectified"}


def periodic_disturbance(build, rng, scales, at, size):
    """A fan or a pump out of balance; its phase belongs to the recordings' common clock."""
    amplitude = size * rng.uniform(0.01, 0.05) * scales.force
    frequency = np.exp(rng.uniform(np.log(2.0), np.log(45.0)))
    phase = rng.uniform(-np.pi, np.pi)
    build.add(kernel.SINE_OF_TIME, build.port(at), amplitude, frequency, phase)
    return {"amplitude": amplitude, "frequency": frequency, "phase": phase}


def drift(build, rng, scales, at, size):
    """Thermal state: a part warms by a constant source that is switched on at t = 0, and pushes.

    On recordings that share a clock it goes on; otherwise each recording starts cold.
    """
    amplitude = size * rng.uniform(0.05, 0.15) * scales.force * rng.choice([-1, 1])
    time_constant = scales.duration * rng.uniform(0.3, 1.2)
    build.add(kernel.THERMAL, build.port(at), amplitude, time_constant, 0.0, 1.0)
    return {"amplitude": amplitude, "time_constant": time_constant}


@dataclass(frozen=True)
class Maker:
    """An effect, where it lives, and the siblings that count as its family."""

    make: Make
    component: str
    family: str
    machines: tuple[str, ...] = ()  # empty: all
    dimension: tuple[str, ...] = ()  # parameters that are forces (N per something)


EFFECTS: dict[str, Maker] = {
    "coulomb_friction": Maker(coulomb_friction, "plant", "dry friction", (), ("level",)),
    "asymmetric_friction": Maker(
        asymmetric_friction, "plant", "dry friction", (), ("level_positive", "level_negative")
    ),
    "viscous_friction": Maker(viscous_friction, "plant", "damping", (), ("coefficient",)),
    "stribeck_friction": Maker(
        stribeck_friction, "plant", "dry friction", (), ("coulomb_level", "static_level")
    ),
    "presliding_friction": Maker(
        presliding_friction,
        "plant",
        "dry friction",
        (),
        ("level", "stiffness", "micro_damping"),
    ),
    "position_dependent_friction": Maker(
        position_dependent_friction, "plant", "dry friction", (), ("level", "table")
    ),
    "constant_load": Maker(constant_load, "environment", "slow force", (), ("force",)),
    "cogging": Maker(cogging, "actuator", "force ripple", (), ("amplitude", "amplitude_2")),
    "linear_stiffness": Maker(linear_stiffness, "plant", "stiffness", (), ("stiffness",)),
    "hardening_spring": Maker(hardening_spring, "plant", "stiffness", (), ("cubic_coefficient",)),
    "position_dependent_gain": Maker(position_dependent_gain, "actuator", "gain"),
    "quadratic_drag": Maker(quadratic_drag, "plant", "damping", (), ("coefficient",)),
    "backlash": Maker(backlash, "transmission", "play"),
    "hysteresis": Maker(hysteresis, "plant", "dry friction", (), ("force",)),
    "saturation": Maker(saturation, "actuator", "static actuator"),
    "dead_zone": Maker(dead_zone, "actuator", "static actuator"),
    "input_delay": Maker(input_delay, "actuator", "lateness"),
    "actuator_lag": Maker(actuator_lag, "actuator", "lateness"),
    "flexible_mode": Maker(flexible_mode, "plant", "inertia"),
    "mass_change": Maker(mass_change, "plant", "inertia"),
    "encoder_ripple": Maker(encoder_ripple, "sensor", "sensor"),
    # Behind feedback a clipped or rectified position drives the loop away.
    "sensor_nonlinearity": Maker(sensor_nonlinearity, "sensor", "sensor", ("stiffness",)),
    "periodic_disturbance": Maker(
        periodic_disturbance, "environment", "disturbance", (), ("amplitude",)
    ),
    "drift": Maker(drift, "environment", "slow force", (), ("amplitude",)),
}
