"""Faults of a recording: what is written down is not what happened."""

from __future__ import annotations

import numpy as np

from ffl.challenge.draw import Setup

FAULTS = (
    "unit",
    "sign",
    "shift",
    "sample_time",
    "frozen_sensor",
    "clipped_sensor",
    "gaps",
    "wrong_controller",
)


def spoil(fault: str, recordings: dict, setup: Setup, rng: np.random.Generator) -> dict:
    """Spoil the recordings in place (experiment, y, u); what the writer must do is returned."""
    truth: dict = {"name": fault}
    if fault == "unit":
        truth["column"] = str(rng.choice(["y", "u"]))
        truth["factor"] = float(rng.choice([1e3, 1e-3]))
    if fault == "sign":
        truth["column"] = str(rng.choice(["y", "u"]))
    if fault == "shift":
        truth["samples"] = int(rng.choice([-1, 1]) * rng.integers(4, 40))
    if fault == "sample_time":
        truth["clock_factor"] = float(rng.choice([0.5, 2.0, 1.25]))
    if fault == "gaps":
        truth["gaps"] = {}
    if fault == "wrong_controller":
        truth["controller_factor"] = float(rng.choice([0.7, 0.8, 1.25, 1.5]))
    for file, (e, y, u) in recordings.items():
        n = len(y)
        if fault == "unit":
            y, u = (y * truth["factor"], u) if truth["column"] == "y" else (y, u * truth["factor"])
        elif fault == "sign":
            y, u = (-y, u) if truth["column"] == "y" else (y, -u)
        elif fault == "shift":
            y = np.roll(y, truth["samples"])
            k = truth["samples"]
            if k > 0:
                y[:k] = y[k]
            else:
                y[k:] = y[k - 1]
        elif fault == "frozen_sensor":
            start = int(rng.uniform(0.3, 0.6) * n)
            y = y.copy()
            y[start : start + int(rng.uniform(0.1, 0.3) * n)] = y[start]
        elif fault == "clipped_sensor":
            low, high = y.min(), y.max()
            y = np.minimum(y, high - 0.15 * (high - low))
        elif fault == "gaps":
            start = int(rng.uniform(0.2, 0.7) * n)
            truth["gaps"][file] = [start, start + int(rng.integers(20, 400))]
        recordings[file] = (e, y, u)
    return truth
