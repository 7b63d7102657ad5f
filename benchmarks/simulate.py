"""Speed of the closed-loop simulation: samples a second with three effects, and against dlsim.

A 12-state loop (rigid body, four modes, second-order controller) with Coulomb friction, cogging and
an actuator lag; and the same loop without effects against `scipy.signal.dlsim`. One core.

    python benchmarks/simulate.py [--json]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

import numpy as np
import scipy.linalg
import scipy.signal

from ffl.machines import Simulator
from ffl.systems.loop import Controller
from ffl.systems.plant import EffectSpec, Plant
from ffl.systems.state_space import StateSpace
from ffl.systems.zpk import Zpk

SAMPLE_TIME = 1e-3
EFFECTS = (
    EffectSpec("coulomb_friction", {"level": 5.0}),
    EffectSpec("cogging", {"amplitude": 3.0, "period": 0.01, "phase": 0.3}),
    EffectSpec("actuator_lag", {"time_constant": 1e-3}),
)


def stage() -> Plant:
    """10 kg with modes at 60, 95, 140 and 210 Hz, measured at the motor; lead-lag controller."""
    blocks = [np.array([[0.0, 1.0], [0.0, 0.0]])]
    for frequency in (60.0, 95.0, 140.0, 210.0):
        w = 2 * np.pi * frequency
        blocks.append(np.array([[0.0, 1.0], [-w * w, -0.04 * w]]))
    a = scipy.linalg.block_diag(*blocks)
    b = np.tile([0.0, 1.0], 5)
    c = np.ravel([[residue, 0.0] for residue in (0.1, 0.03, 0.02, 0.02, 0.01)])
    block = np.zeros((11, 11))
    block[:10, :10], block[:10, 10] = a, b
    exponential = scipy.linalg.expm(block * SAMPLE_TIME)
    system = StateSpace(exponential[:10, :10], exponential[:10, 10:], c, 0.0, SAMPLE_TIME)
    controller = Zpk([0.985, 0.999], [0.8, 1.0], 20000.0, SAMPLE_TIME)
    return Plant("stage", system, Controller.of_error(controller), "N", "m")


def best(work: Callable[[], object], repeats: int = 7) -> float:
    """Shortest processor time of several runs, in seconds; wall time on a busy machine is the
    neighbours'."""
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return min(seconds)


def measure() -> dict[str, float]:
    plant = stage()
    loop = plant.require_stable()
    simulator = Simulator(plant)
    n = 200_000
    t = SAMPLE_TIME * np.arange(n)
    reference = 0.05 * np.sin(2 * np.pi * t) ** 3
    with_effects = simulator.run(EFFECTS, reference)
    linear = simulator.run((), reference)
    seconds = best(lambda: simulator.run(EFFECTS, reference))
    linear_seconds = best(lambda: simulator.run((), reference))
    short = reference[:20_000]
    system = loop.system.select([0, 1], [0])
    other = (system.a, system.b, system.c, system.d, SAMPLE_TIME)
    _, y, _ = scipy.signal.dlsim(other, short)
    dlsim_seconds = best(lambda: scipy.signal.dlsim(other, short), 3) * n / len(short)
    disagreement = np.abs(y[:, 0] - linear.y[: len(short)]).max() / np.abs(y[:, 0]).max()
    if disagreement > 1e-9 or with_effects.diverged:
        raise SystemExit(f"simulate: disagreement with dlsim {disagreement:.1e}")
    return {
        "ratio_to_dlsim": dlsim_seconds / linear_seconds,
        "samples_per_second": n / seconds,
        "samples_per_second_linear": n / linear_seconds,
        "states": float(system.order),
        "disagreement": float(disagreement),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed of the closed-loop simulation.")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    as_json = parser.parse_args().json
    result = measure()
    if as_json:
        print(json.dumps(result))
        return
    for key, value in result.items():
        print(f"{key:28s} {value:.4g}")


if __name__ == "__main__":
    main()
