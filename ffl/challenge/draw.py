"""Drawing a machine, its nominal model, its servo and its experiments."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ffl.challenge.body import CONTROLLER_2018, FAMILIES, Body, Family
from ffl.challenge.build import Build, Scales
from ffl.challenge.linear import Noise, Servo, Zpk, design_servo
from ffl.challenge.motion import KINDS, injection, path
from ffl.errors import InputError

PRE_ROLL = 1.0  # s of hold that are simulated and not recorded
STEP = 40e-6  # s, the longest small step


@dataclass(frozen=True)
class Experiment:
    """What is sent to the machine: reference and feedforward with the hold before the record."""

    kind: str
    reference: np.ndarray
    feedforward: np.ndarray
    skip: int  # samples before the recording begins
    clock: float  # s, t of the first recorded sample
    start: float  # s, time of the machine's own clock at the first simulated sample


@dataclass(frozen=True)
class Setup:
    """A machine with everything but effects and noise."""

    family: str
    sample_time: float
    steps: int
    true: Body
    nominal: Body
    servo: Servo | None
    fit: tuple[Experiment, ...]
    validate: tuple[Experiment, ...]
    physics_known: bool
    corrections: dict[str, float]  # true over nominal, minus one
    parameters: dict[str, float]  # true


def draw_body(
    name: str, sample_time: float, doubt: str, rng: np.random.Generator
) -> tuple[Body, Body, dict, dict]:
    """True body, nominal body, corrections (true/nominal - 1) and true parameters.

    doubt: "careful" (fractions of a per cent), "wrong" (parameter errors up to the contract's
    line between correction and effect), "exact", or the name of the one parameter 5 to 10 % off.
    """
    family = FAMILIES[name]
    p = {key: float(rng.uniform(*span)) for key, span in family.ranges.items()}
    p["sample_time"] = sample_time
    p["viscous"] = p["mass"] / p["damping_time"] if "damping_time" in p else 0.0
    nominal = dict(p)
    corrections = {}
    for key, sd in family.doubts:
        error = float(np.clip(sd * rng.standard_normal(), -2 * sd, 2 * sd))
        if doubt == "exact":
            error = 0.0
        if doubt == "wrong":
            top = {"mass": 0.018, "viscous": 0.1, "zeta": 0.3, "z2": 0.2}.get(key, 0.03)
            if name == "stiffness":
                # Its spring is a force on the plant, wrong by the mass's error and twice this.
                top = {"mass": 0.008, "frequency": 0.004}.get(key, top)
            error = float(rng.uniform(0.4, 1.0) * top * rng.choice([-1, 1]))
        if doubt == key:
            error = float(rng.uniform(0.05, 0.10) * rng.choice([-1, 1]))
        nominal[key] = p[key] / (1 + error)
        corrections[key] = error
    return family.assemble(p), family.assemble(nominal), corrections, p


def _servo(name: str, nominal: Body, sample_time: float, rng: np.random.Generator) -> Servo | None:
    if name == "stiffness":
        return None
    if name == "kernel2018":
        zeros, poles, gain = CONTROLLER_2018
        return Servo(Zpk(zeros, poles, gain / nominal.constant))
    wide = rng.uniform(*FAMILIES[name].bandwidth)
    integral = bool(rng.random() < 0.4) and name != "printer"
    split = bool(rng.random() < 0.25) and name == "rigid"
    return design_servo(nominal, sample_time, wide, integral, split)


def _experiment(
    kind: str,
    clock: float,
    start: float,
    name: str,
    nominal: Body,
    family: Family,
    sample_time: float,
    style: dict[str, float],
    rng: np.random.Generator,
) -> Experiment:
    n = round(style["duration"] / sample_time)
    hold = rng.uniform(0.2, 0.5)
    late = rng.random() < 0.08  # the recorder was started in mid-motion
    pre = round((PRE_ROLL + (1.0 if late else 0.0)) / sample_time)
    total = n + pre
    rest = PRE_ROLL + (0.0 if late else hold)
    x = path(
        kind, total, sample_time, style["stroke"], style["speed"], style["acceleration"], rest, rng
    )
    if style["centred"] and kind != "multisine":
        t = np.arange(total) * sample_time - rest
        s = np.clip(t / 0.4, 0.0, 1.0)
        x = x - 0.5 * style["stroke"] * s**3 * (10 - 15 * s + 6 * s * s)
    extra = np.zeros(total)
    if kind == "multisine" and style["injection"] > 0:
        extra = injection(total, sample_time, style["top"], rest, rng)
    if name == "stiffness":
        unit = nominal.stiffness[0, 0] / nominal.constant
        drive = unit * (x + style["injection"] * 0.2 * style["stroke"] * extra)
        return Experiment(kind, np.zeros(total), drive, pre, clock, start)
    acceleration = np.zeros(total)
    acceleration[1:-1] = np.diff(x, 2) / sample_time**2
    unit = nominal.moving_mass / nominal.constant
    feedforward = style["feedforward"] * unit * acceleration
    feedforward = feedforward + style["injection"] * unit * style["acceleration"] * extra
    return Experiment(kind, x, feedforward, pre, clock, start)


def draw_setup(name: str, doubt: str, rng: np.random.Generator) -> Setup:
    """One machine with one to three experiments to fit and one or two of another kind to judge."""
    if name not in FAMILIES:
        raise InputError(f"machine '{name}' is unknown; one of {', '.join(FAMILIES)}")
    family = FAMILIES[name]
    sample_time = float(rng.choice(family.sample_times))
    true, nominal, corrections, parameters = draw_body(name, sample_time, doubt, rng)
    servo = _servo(name, nominal, sample_time, rng)
    style = {
        "duration": rng.uniform(4.0, 8.0),
        "stroke": rng.uniform(*family.stroke),
        "speed": rng.uniform(*family.speed),
        "acceleration": rng.uniform(*family.acceleration),
        "centred": rng.random() < 0.5,
        "feedforward": float(rng.choice([0.0, 1.0])),
        "injection": float(rng.choice([0.0, rng.uniform(0.05, 0.2)])),
        "top": min(120.0, 0.2 / sample_time),
    }
    kinds = list(KINDS)
    rng.shuffle(kinds)
    judge, others = kinds[0], kinds[1:]
    fit_kinds = [others[k % 2] for k in range(int(rng.integers(1, 4)))]
    plan = fit_kinds + [judge] * (2 if rng.random() < 0.15 else 1)
    shared = rng.random() < 0.7
    clock, made = 0.0, []
    for k, kind in enumerate(plan):
        own = clock if shared or k == 0 else float(rng.uniform(20.0, 400.0))
        shown = clock if shared else 0.0
        e = _experiment(kind, shown, 0.0, name, nominal, family, sample_time, style, rng)
        start = own - e.skip * sample_time
        made.append(Experiment(e.kind, e.reference, e.feedforward, e.skip, shown, start))
        clock += len(e.reference) * sample_time + float(np.round(rng.uniform(2.0, 15.0), 1))
    setup = Setup(
        name,
        sample_time,
        round(sample_time / STEP),
        true,
        nominal,
        servo,
        tuple(made[: len(fit_kinds)]),
        tuple(made[len(fit_kinds) :]),
        bool(rng.random() < 0.8) and name != "kernel2018",
        corrections,
        parameters,
    )
    return _within_the_line(setup)


def _within_the_line(setup: Setup) -> Setup:
    """Make a wrong damping smaller until its force is at most 1.5 % of the RMS force.

    From 2 % on the contract calls it viscous_friction.
    """
    key = next((k for k in ("viscous", "zeta") if k in setup.corrections), None)
    if key is None or (key == "zeta" and setup.family != "stiffness"):
        return setup
    scales = measure(setup)
    coefficient = setup.true.damping[0, 0] if key == "zeta" else setup.parameters["viscous"]
    share = coefficient * scales.speed_rms / scales.force_rms
    error = setup.corrections[key]
    top = 0.015 / share
    if abs(error) <= top:
        return setup
    corrections = {**setup.corrections, key: float(np.sign(error) * top)}
    nominal = {k: v / (1 + corrections.get(k, 0.0)) for k, v in setup.parameters.items()}
    return replace(setup, nominal=FAMILIES[setup.family].assemble(nominal), corrections=corrections)


def measure(setup: Setup, build: Build | None = None) -> Scales:
    """Sizes of the motion without noise, of the machine as built (None: without effects)."""
    u, x, v = [], [], []
    build = Build.of(setup.true) if build is None else build
    for e in setup.fit:
        run = build.run(setup.servo, e.reference, e.feedforward, setup.sample_time, 8)
        u.append(run[1][e.skip :])
        x.append(run[2][e.skip :])
        v.append(run[3][e.skip :])
    command, position, speed = np.concatenate(u), np.concatenate(x), np.concatenate(v)
    force = np.abs(command).max() * setup.true.constant
    return Scales(
        force=float(force),
        command=float(np.abs(command).max()),
        command_levels=np.quantile(np.abs(command), np.linspace(0, 1, 101)),
        force_rms=float(np.sqrt(np.mean(command**2)) * setup.true.constant),
        speed=float(np.abs(speed).max()),
        speed_rms=float(np.sqrt(np.mean(speed**2))),
        acceleration=float(np.abs(np.diff(speed)).max() / setup.sample_time),
        low=float(position.min()),
        high=float(position.max()),
        position_rms=float(np.std(position)),
        sample_time=setup.sample_time,
        duration=float(np.mean([len(e.reference) for e in setup.fit]) * setup.sample_time),
        quantum=setup.sample_time / setup.steps,
    )


def draw_noise(setup: Setup, scales: Scales, rng: np.random.Generator) -> Noise:
    """What the machine's encoder and drive bring along."""
    resolution = float(np.exp(rng.uniform(*np.log(FAMILIES[setup.family].resolution))))
    white = resolution * rng.uniform(0.3, 1.5)
    force = scales.command * rng.uniform(0.001, 0.006)
    return Noise(
        sensor=white,
        sensor_coloured=white * rng.uniform(0.5, 2.0) * (rng.random() < 0.3),
        sensor_corner=rng.uniform(10.0, 80.0),
        force=force,
        force_coloured=force * rng.uniform(0.3, 1.5) * (rng.random() < 0.5),
        force_corner=rng.uniform(3.0, 40.0),
        resolution=resolution,
    )
