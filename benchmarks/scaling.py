"""Cost of the free-signal update against the number of samples, and its agreement with a dense one.

`python benchmarks/scaling.py [--json]`
"""

from __future__ import annotations

import argparse
import json
import resource
from typing import Any

import numpy as np
from _timing import median_seconds

from ffl.learn import FreeSignalUpdate, Weights
from ffl.systems import load_plant

WEIGHTS = Weights(50.0, 1e-7, 0.0)


def seconds(n: int) -> float:
    """One update of N samples, from prepared matrices."""
    model = load_plant("flatbed_printer")
    rng = np.random.default_rng(0)
    error, previous = 1e-3 * rng.standard_normal(n), np.zeros(n)
    update = FreeSignalUpdate(model, np.zeros(n), WEIGHTS)
    return median_seconds(lambda: update.update(previous, error), 1 if n >= 10**6 else 3)


def dense_agreement(n: int = 500) -> float:
    """Largest difference to the lifted solution, relative to the largest change of f."""
    model = load_plant("flatbed_printer")
    rng = np.random.default_rng(1)
    error, previous = 1e-3 * rng.standard_normal(n), rng.standard_normal(n)
    ours = FreeSignalUpdate(model, np.zeros(n), WEIGHTS).update(previous, error).feedforward
    h = model.loop.process_sensitivity.impulse_response(n)
    lifted = np.array([[h[i - k] if i >= k else 0.0 for k in range(n)] for i in range(n)])
    stacked = np.vstack([np.sqrt(50.0) * lifted, np.sqrt(1e-7) * np.eye(n)])
    target = np.concatenate([np.sqrt(50.0) * error, -np.sqrt(1e-7) * previous])
    change = np.linalg.lstsq(stacked, target, rcond=None)[0]
    return float(np.abs(ours - previous - change).max() / np.abs(change).max())


def measure() -> dict[str, Any]:
    sizes = [10_000, 100_000, 1_000_000]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    taken = [seconds(n) for n in sizes]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    exponent = float(np.polyfit(np.log(sizes), np.log(taken), 1)[0])
    return {
        "exponent": exponent,
        "dense_agreement_500": dense_agreement(),
        "free_signal_seconds_1e6": taken[-1],
        "free_signal_peak_mib_1e6": peak,
        "peak_mib_before": before,
        "seconds": dict(zip(map(str, sizes), taken, strict=True)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    result = measure()
    if parser.parse_args().json:
        print(json.dumps(result))
        return
    for name, value in result.items():
        print(f"{name:26} {value}")


if __name__ == "__main__":
    main()
