"""Seconds per diagnosed case: three recordings of 20,000 samples, friction concealed, two cores.

A rigid stage with a lead controller and Stribeck friction; two recordings are fitted, one judges.
`ratio` = wanted time (20 s) over ours.

    python benchmarks/diagnose.py [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import time
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from ffl.diagnose import diagnose
from ffl.machines import SimulatedMachine
from ffl.systems import Controller, Move, Physics, Plant, Zpk, moves
from ffl.systems.plant import EffectSpec, Imperfections

STEP, SAMPLES, WANTED = 0.001, 20_000, 20.0


def stage() -> Plant:
    """6 kg, 12 N/A, lead with 15 Hz bandwidth."""
    zero, pole = np.exp(-2 * np.pi * 5.0 * STEP), np.exp(-2 * np.pi * 45.0 * STEP)
    lead = Zpk(np.array([zero]), np.array([pole]), 1.0, STEP)
    gain = 6.0 * (2 * np.pi * 15.0) ** 2 / 12.0 / abs(lead.response([15.0])[0])
    system = Zpk(np.array([-1.0]), np.array([1.0, 1.0]), 12.0 * STEP**2 / 12.0, STEP)
    return Plant(
        "stage", system, Controller.of_error(replace(lead, gain=gain)), "A", "m", "benchmark",
        Physics(6.0, 12.0), Imperfections(1e-7, 1e-7, 2e-3, None),
    )  # fmt: skip


def reference(seed: int) -> np.ndarray:
    """Moves back and forth for 20 s."""
    rng = np.random.default_rng(seed)
    path = [
        Move(0.3 + 0.9 * k, (-1) ** k * 0.08, float(rng.uniform(0.1, 0.3)), 4.0, 200.0)
        for k in range(20)
    ]
    return moves(path, SAMPLES * STEP, STEP)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", action="store_true")
    as_json = parser.parse_args().json
    model = stage()
    friction = {"coulomb_level": 1.5, "static_level": 2.5, "stribeck_velocity": 0.02}
    machine = SimulatedMachine(replace(model, effects=(EffectSpec("stribeck_friction", friction),)))
    rng = np.random.default_rng(1)
    recordings = [machine.run(reference(k), np.zeros(SAMPLES), rng) for k in range(3)]
    diagnose(model, [r[:2000] for r in recordings[:2]], [recordings[2][:2000]])  # compiles
    start, used = time.perf_counter(), time.process_time()
    answer = diagnose(model, recordings[:2], recordings[2:]).answer()
    seconds, used = time.perf_counter() - start, time.process_time() - used
    out = {
        "ratio": WANTED / seconds,
        "seconds_per_case": seconds,
        "cpu_seconds_per_case": used,
        "named": [e["name"] for e in answer["effects"]],
        "nrmse_after_over_floor": answer["validation"]["nrmse_after"]
        / answer["validation"]["noise_floor"],
    }
    print(json.dumps(out, indent=1) if as_json else "\n".join(f"{k}: {v}" for k, v in out.items()))


if __name__ == "__main__":
    main()
