"""Machines of other fields whose model is stated by hand: an arm, a tank, a spindle that grows with heat.

For `foreign.py`: each writes plant.toml, data.map.toml and recordings, by small steps of its own.
"""

from __future__ import annotations

import itertools
import math

import h5py
import numpy as np
from numba import njit

ZERO, POLE, GAIN = math.exp(-0.012), math.exp(-0.5), 43642.0  # of the arm's lead, 1 kHz


@njit
def _arm(reference, push, gain, zero, pole, per, h):  # type: ignore[no-untyped-def]
    """2.4 kg m^2 with 1.5 N m s/rad, 35 N m of weight and a harmonic drive's 1.5 N m, under a lead."""
    n = len(reference)
    q, u = np.zeros(n), np.zeros(n)
    x, v = reference[0], 0.0
    last = 35.0 * math.sin(x) - 1.5 * math.sin(2 * math.pi * x / 0.0314159 + 0.7)  # it is held
    error = last * (1.0 - pole) / (gain * (1.0 - zero))
    x -= error
    for k in range(n):
        q[k] = 5e-6 * round(x / 5e-6)
        now = reference[k] - q[k]
        last = pole * last + gain * (now - zero * error)
        u[k], error = last, now
        for _ in range(per):
            ripple = 1.5 * math.sin(2 * math.pi * x / 0.0314159 + 0.7)
            x += 0.5 * h * v
            v += h * (last + push[k] - 35.0 * math.sin(x) + ripple - 1.5 * v) / 2.4
            x += 0.5 * h * v
    return q, u


def _swings(stops, rate, pause):  # type: ignore[no-untyped-def]
    """Quintic moves from stop to stop, 1.2 s per radian, with pauses."""
    parts = [np.full(round(pause * rate), stops[0])]
    for a, b in itertools.pairwise(stops):
        s = np.linspace(0.0, 1.0, round(1.2 * abs(b - a) * rate) + 1)[1:]
        parts += [a + (b - a) * s**3 * (10 - 15 * s + 6 * s**2), np.full(round(pause * rate), b)]
    return np.concatenate(parts)


def arm(folder, rng):  # type: ignore[no-untyped-def]
    moves = {"run1": (0.0, 1.4, -1.0, 0.5, 0.0), "val": (0.0, -0.6, 1.1, -0.9, 1.3, 0.0)}
    with h5py.File(folder / "arm.h5", "w") as file:
        for name, stops in moves.items():
            r = _swings(stops, 1000, 0.25)
            q, u = _arm(r, 0.05 * rng.standard_normal(len(r)), GAIN, ZERO, POLE, 50, 2e-5)
            for key, signal in (("t_ms", np.arange(len(r))), ("ref", np.degrees(r)),
                                ("angle", np.degrees(q)), ("torque", u)):  # fmt: skip
                file[f"{name}/{key}"] = signal
    turn, listed = f'scale = {math.pi / 180!r}, unit = "rad"', ""
    for name in moves:
        listed += (
            f'[[recordings]]\nname = "{name}"\n[recordings.columns]\n'
            f't = {{ name = "{name}.t_ms", scale = 1e-3 }}\nr = {{ name = "{name}.ref", {turn} }}\n'
            f'y = {{ name = "{name}.angle", {turn} }}\nu = {{ name = "{name}.torque", unit = "Nm" }}\n'
        )
    (folder / "data.map.toml").write_text(listed)
    (folder / "plant.toml").write_text(
        'name = "arm"\nsample_time = 0.001\n[units]\ninput = "Nm"\noutput = "rad"\n'
        '[plant]\nform = "czpk"\nzeros = []\npoles = [0.0, -0.625]\ngain = 0.4166666666666667\n'
        f'[controller]\nform = "zpk"\nzeros = [{ZERO!r}]\npoles = [{POLE!r}]\ngain = {GAIN}\n'
        "[physics]\nmass = 2.4\n"
        "[machine]\nencoder_resolution = 5e-6\nsensor_noise = 2e-6\nforce_noise = 0.05\n"
    )
    return "arm.h5::run1", "arm.h5::val"


def _steps(n, hold, size, rng):  # type: ignore[no-untyped-def]
    return np.repeat(rng.uniform(-size, size, n // hold + 1), hold)[:n].round(1)


def tank(folder, rng):  # type: ignore[no-untyped-def]
    """A level about 60 cm over an orifice: 309.8 s where it was linearised, by the root of it elsewhere."""
    rate, gain, lag = 2.0, 0.0077459667, 309.8387
    for name, size in (("night1", 19.0), ("val", 18.0)):
        u, x = _steps(3000, 150, size, rng), 0.0
        y = np.zeros(len(u))
        for k, command in enumerate(u):
            y[k] = x
            for _ in range(20):
                out = 120.0 / lag * (math.sqrt(max(x + 60.0, 0.0) / 60.0) - 1.0)
                x += rate / 20 * (gain * command - out)
        level = (60.0 + y + 0.1 * rng.standard_normal(len(y))).round(2)
        lines = ["Zeit;Ventil [%];Pegel [cm]"]
        lines += [
            f"{rate * k:g};{a:g};{b:g}" for k, (a, b) in enumerate(zip(u, level, strict=True))
        ]
        (folder / f"{name}.csv").write_text("\n".join(lines).replace(".", ",") + "\n")
    (folder / "data.map.toml").write_text(
        '[columns]\nt = "Zeit"\nu = "Ventil"\ny = { name = "Pegel", offset = -60.0, unit = "cm" }\n'
    )
    (folder / "plant.toml").write_text(
        'name = "tank"\nsample_time = 2.0\n[units]\ninput = "%"\noutput = "cm"\n'
        f'[plant]\nform = "czpk"\nzeros = []\npoles = [{-1 / lag!r}]\ngain = {gain}\n'
        "[machine]\nsensor_noise = 0.1\n"
    )
    return "night1.csv", "val.csv"


def spindle(folder, rng):  # type: ignore[no-untyped-def]
    """Growth by heat that the model knows, and a housing that grows the other way by hours: linear, and no
    effect of the catalogue."""
    lags, gains = (900.0, 5200.0), (0.021, -0.007)
    for name in ("tag1", "tag2"):
        u = np.repeat(rng.uniform(0.0, 1500.0, 30), 100).round(0)
        states, y = np.zeros(2), np.zeros(len(u))
        for k, power in enumerate(u):
            y[k] = states.sum()
            for part, (lag, gain) in enumerate(zip(lags, gains, strict=True)):
                end = gain * power
                states[part] = end + (states[part] - end) * math.exp(-10.0 / lag)
        y = (y + 0.05 * rng.standard_normal(len(y))).round(2)
        lines = ["t [s],P [W],dz [um]"] + [
            f"{10 * k},{a:g},{b:g}" for k, (a, b) in enumerate(zip(u, y, strict=True))
        ]
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    (folder / "data.map.toml").write_text('[columns]\nt = "t"\nu = "P"\ny = "dz"\n')
    (folder / "plant.toml").write_text(
        'name = "spindle"\nsample_time = 10.0\n[units]\ninput = "W"\noutput = "um"\n'
        f'[plant]\nform = "czpk"\nzeros = []\npoles = [{-1 / lags[0]!r}]\ngain = {gains[0] / lags[0]!r}\n'
        "[machine]\nsensor_noise = 0.06\n"
    )
    return "tag1.csv", "tag2.csv"
