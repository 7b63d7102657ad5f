"""Six effects that neither the catalogue nor the challenge knows: does the diagnosis say `unnamed`?

Each acts on a machine of the independent generator as a force at the motor or as an error of the
sensor, a function of the true motion found by repetition (the run gives the motion, the motion the
force, until both agree). Right: `unnamed`, or `partly_explained`, with a variable that it depends on;
wrong: `explained`, or silence.

    python benchmarks/strangers.py [--seed 1] [--machines rigid two_mass_motor] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from _cases import read_case

from ffl.challenge import write
from ffl.challenge.build import Build, Scales
from ffl.challenge.draw import draw_noise, draw_setup, measure
from ffl.diagnose import diagnose

ROUNDS = 40


@dataclass(frozen=True)
class Stranger:
    """`signal(x, v, u, t, scales, rng)`: N at the motor, or output units at the sensor."""

    name: str
    port: str
    depends_on: tuple[str, ...]
    signal: Callable[..., np.ndarray]


def cubic_drag(x, v, u, t, s: Scales, rng):  # type: ignore[no-untyped-def]
    """Stirring loss: drag with the third power of the speed."""
    return -0.15 * s.force * (v / s.speed) ** 3


def sticky_stretch(x, v, u, t, s: Scales, rng):  # type: ignore[no-untyped-def]
    """Grease gathered along the stroke: a damping that comes and goes with the position."""
    wave = 1.0 + np.sin(2 * np.pi * (x - s.low) / (0.45 * s.stroke) + 0.7)
    return -0.12 * s.force * wave * v / s.speed


def soft_iron(x, v, u, t, s: Scales, rng):  # type: ignore[no-untyped-def]
    """Iron that saturates: the force per current falls as the current grows."""
    return s.force * (np.tanh(0.8 * u / s.command) / 0.8 - u / s.command)


def reluctance(x, v, u, t, s: Scales, rng):  # type: ignore[no-untyped-def]
    """Pull of the iron itself: with the square of the current, changing sign along the stroke."""
    return 0.25 * s.force * (u / s.command) ** 2 * np.sin(2 * np.pi * x / (0.4 * s.stroke) + 0.3)


def stepped_scale(x, v, u, t, s: Scales, rng):  # type: ignore[no-untyped-def]
    """A measuring tape joined from two pieces: a smooth step of the scale in mid-stroke."""
    middle = s.low + 0.55 * s.stroke
    return 3e-4 * s.stroke * np.tanh((x - middle) / (0.06 * s.stroke))


def catching_hose(x, v, u, t, s: Scales, rng):  # type: ignore[no-untyped-def]
    """A hose that catches and lets go, when it likes."""
    force = np.zeros(len(t))
    for at in np.flatnonzero(rng.random(len(t)) < 0.8 * s.sample_time):
        force[at : at + round(rng.uniform(0.05, 0.15) / s.sample_time)] += (
            0.12 * s.force * rng.choice([-1, 1])
        )
    return force


STRANGERS = (
    Stranger("cubic_drag", "force", ("velocity",), cubic_drag),
    Stranger("sticky_stretch", "force", ("position", "velocity"), sticky_stretch),
    Stranger("soft_iron", "force", ("command",), soft_iron),
    Stranger("reluctance", "force", ("command", "position"), reluctance),
    Stranger("stepped_scale", "output", ("position",), stepped_scale),
    Stranger("catching_hose", "force", ("time",), catching_hose),
)


def record(stranger: Stranger, machine: str, seed: int, folder: Path) -> None:
    """Writes the case: plant.toml, fit_*.csv, validate_*.csv."""
    rng = np.random.default_rng([seed, STRANGERS.index(stranger)])
    setup = draw_setup(machine, "careful", rng)
    scales = measure(setup)
    noise = draw_noise(setup, scales, rng)
    (folder / "plant.toml").write_text(write.plant_text(setup, noise, None))
    for label, plans in (("fit", setup.fit), ("validate", setup.validate)):
        for k, e in enumerate(plans):
            n = len(e.reference)
            t = np.arange(n) * setup.sample_time
            sensor, force = noise.draw(n, setup.sample_time, rng)
            own = int(rng.integers(2**31))
            added, y = np.zeros(n), np.zeros(n)
            for _ in range(ROUNDS):
                build = Build.of(setup.true)
                at_motor = stranger.port == "force"
                out = build.run(
                    setup.servo, e.reference, e.feedforward, setup.sample_time, setup.steps,
                    sensor if at_motor else sensor + added, force, added if at_motor else None, None,
                    e.start,
                )  # fmt: skip
                change, (y, u, x, v) = np.abs(out[0] - y).max(), out
                fresh = stranger.signal(x, v, u, t, scales, np.random.default_rng(own))
                added = added + 0.7 * (fresh - added)
                if change < 0.1 * noise.sensor:
                    break
            y = np.round(y / noise.resolution) * noise.resolution if noise.resolution else y
            rows = write.columns(e, y[e.skip :], u[e.skip :], setup.sample_time)
            write.table(folder / f"{label}_{k + 1}.csv", rows)


def one(stranger: Stranger, machine: str, seed: int) -> dict:
    """What the diagnosis answers."""
    with tempfile.TemporaryDirectory() as home:
        folder = Path(home)
        record(stranger, machine, seed, folder)
        plant, fit, validate = read_case(folder)
    start = time.process_time()
    answer = diagnose(plant, fit, validate, rng=np.random.default_rng(0)).answer()
    place = answer["location"]
    right = answer["verdict"] in ("unnamed", "partly_explained") and bool(
        set(place.get("depends_on", [])) & set(stranger.depends_on)
    )
    return {
        "effect": stranger.name,
        "machine": machine,
        "verdict": answer["verdict"],
        "names": [e["name"] for e in answer["effects"]],
        "depends_on": place.get("depends_on", []),
        "formula": place.get("formula", ""),
        "right": right,
        "cpu": round(time.process_time() - start, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--machines", nargs="+", default=["rigid", "two_mass_motor"])
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rows = []
    for machine in options.machines:
        for stranger in STRANGERS:
            rows.append(one(stranger, machine, options.seed))
            if not options.json:
                print(*rows[-1].values(), sep="  ", flush=True)
    share = sum(r["right"] for r in rows) / len(rows)
    wrong = sum(r["verdict"] == "explained" for r in rows)
    if options.json:
        print(json.dumps({"right": share, "explained": wrong, "cases": rows}, indent=1))
    else:
        print(f"right {100 * share:.0f} %, explained by a wrong name {wrong} of {len(rows)}")


if __name__ == "__main__":
    main()
