"""How often two encoders on a stiff transmission are said to differ by physics: simulated nulls.

    python benchmarks/second_encoder.py --count 600 --seed 4000 [--json]

Every case is drawn anew: 4 to 10 s at 0.25, 1 or 2 kHz, several moves or one pair, closed or open
loop, the load's mass known or not, noise on either encoder white, first order, both or a resonance,
quantised or not; half of them with a delay of -3 to 6 ms. Named may be the delay where
there is one, and nothing else.
"""

from __future__ import annotations

import argparse
import json
import sys
import time

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import bilinear, butter, lfilter

from ffl.diagnose.transmission.transmission import transmission
from ffl.recordings import Recording
from ffl.systems import Move, Physics, Plant, Zpk, moves

Array = np.ndarray


def noise(rng: np.random.Generator, n: int, step: float) -> Array:
    """White; white and first order; a resonance over a little white; first order."""
    white, kind = rng.standard_normal(n), rng.integers(4)
    if kind == 0:
        return white
    corner = np.exp(rng.uniform(np.log(0.5), np.log(0.2 / step)))
    a = np.exp(-2 * np.pi * corner * step)
    slow = lfilter([np.sqrt(1 - a * a)], [1, -a], rng.standard_normal(n + 2000))[2000:]
    if kind == 1:
        return white + slow * rng.uniform(0.3, 2.5)
    if kind == 2:
        frequency = np.exp(rng.uniform(np.log(3), np.log(0.2 / step)))
        pole = np.exp(-2 * np.pi * frequency * step * rng.uniform(0.02, 0.2))
        bottom = [1, -2 * pole * np.cos(2 * np.pi * frequency * step), pole * pole]
        shaken = lfilter([1], bottom, rng.standard_normal(n + 4000))[4000:]
        return 0.3 * white + shaken / shaken.std()
    return slow


def path(rng: np.random.Generator, duration: float, step: float) -> Array:
    """Moves to and fro with rests."""
    total = np.zeros(int(duration / step))
    at, sign, count, few = 0.3, 1, 0, rng.random() < 0.2
    while at < duration - (4 if few else 2.2) and not (few and count == 2):
        distance = sign * rng.uniform(0.05, 0.2) * (3 if few else 1)
        speed, acceleration = rng.uniform(0.2, 0.5), rng.uniform(1, 4)
        move = Move(at, distance, speed, acceleration, rng.uniform(20, 200))
        total = total + np.asarray(moves([move], duration, step))[: len(total)]
        at, count = at + rng.uniform(1.3, 2.2) + (3 if few else 0), count + 1
        sign = -sign if rng.random() < 0.7 else sign
    return total


def case(seed: int) -> tuple[Plant, Recording, float]:
    """A model, a recording of it with both encoders, and the delay between them [s]."""
    rng = np.random.default_rng(seed)
    step, duration = float(rng.choice([0.0005, 0.001, 0.004])), float(rng.uniform(4, 10))
    mass, constant = float(np.exp(rng.uniform(0, 4))), float(np.exp(rng.uniform(0, 3)))
    r = path(rng, duration, step)
    n = len(r)
    cut = rng.uniform(8, 30)
    w = 2 * np.pi * cut
    servo = bilinear([1.4 * w, w * w], [1, 1.4 * w, w * w], 1 / step)
    friction = rng.uniform(0, 0.3)
    shaking = lfilter(*butter(2, min(60 * step, 0.9)), rng.standard_normal(n))
    shaking = shaking * 10 ** rng.uniform(-8, -5)
    dragged = -friction * np.sign(np.gradient(r, step)) * 1e-4
    y = lfilter(*servo, r) + lfilter(*butter(2, min(cut * 2 * step, 0.9)), dragged) + shaking
    d = None
    if rng.random() < 0.4:
        d = rng.uniform(1, 20) * np.sin(3 * y) * mass / 10
        d = d + rng.uniform(0, 0.2) * mass * np.gradient(np.gradient(r, step), step)
    v = np.gradient(y, step)
    u = mass * np.gradient(v, step) + friction * mass * np.tanh(v / 1e-3)
    u = u / constant + rng.standard_normal(n) * 0.01 - (0 if d is None else d)
    level = 10 ** rng.uniform(-8, -5.3)
    other = level * 10 ** rng.uniform(-0.7, 0.7)
    delay = float(rng.uniform(-0.003, 0.006)) if rng.random() < 0.5 else 0.0
    t = np.arange(n) * step
    y_load = CubicSpline(t, y)(np.clip(t - delay, 0, None)) if delay else y
    y, y_load = y + level * noise(rng, n, step), y_load + other * noise(rng, n, step)
    if rng.random() < 0.5:
        y, y_load = (np.round(x / s / 2) * s * 2 for x, s in ((y, level), (y_load, other)))
    load = None if rng.random() < 0.5 else mass * rng.uniform(0.3, 1)
    known = Physics() if rng.random() < 0.15 else Physics(mass, constant, load)
    system = Zpk([-1.0], [1.0, 1.0], constant * step * step / 2 / mass, step)
    r_known = None if rng.random() < 0.15 else r
    plant = Plant("stage", system, None, "A", "m", "made here", known)
    signals = {"y": y, "y_load": y_load, "u": u, "r": r_known, "d": d}
    return plant, Recording.from_signals(step, **signals), delay


def run(count: int, seed: int) -> dict[str, object]:
    alarms, given, found, silent, began = [], 0, 0, 0, time.process_time()
    for k in range(seed, seed + count):
        plant, recording, delay = case(k)
        told = transmission(plant, [recording])
        if told is None:
            silent += 1
            continue
        names = [p.name for p in told.parts]
        if [x for x in names if x != "delay" or not delay]:
            alarms.append({"seed": k, "named": names})
        given, found = given + bool(delay), found + bool(delay and "delay" in names)
    return {
        "count": count, "seed": seed, "false_alarms": len(alarms), "delays": given,
        "delays_found": found, "not_compared": silent, "alarms": alarms,
        "cpu_seconds_per_case": (time.process_time() - began) / count,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    out = run(given.count, given.seed)
    if given.json:
        json.dump(out, sys.stdout)
        return
    for key, value in out.items():
        print(f"{key}: {value}")


if __name__ == "__main__":
    main()
