"""What periodic effects share: harmonics, sine and cosine to amplitude and phase, trial periods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ffl.effects.base import Motion
from ffl.systems.state_space import Array


def harmonics(values: Mapping[str, Any]) -> list[tuple[float, float]]:
    """(amplitude, phase) of the fundamental and of every harmonic named amplitude_2, phase_2, ..."""
    orders = [int(n.split("_")[1]) for n in values if n.startswith(("amplitude_", "phase_"))]
    pairs = [(float(values["amplitude"]), float(values.get("phase", 0.0)))]
    for k in range(2, max(orders, default=1) + 1):
        pairs.append((values.get(f"amplitude_{k}", 0.0), values.get(f"phase_{k}", 0.0)))
    return pairs


def sine_pair(coefficients: Array) -> dict[str, float]:
    """Amplitude and phase of c_0 sin(angle) + c_1 cos(angle) = amplitude sin(angle + phase)."""
    sine, cosine = float(coefficients[0]), float(coefficients[1])
    return {"amplitude": float(np.hypot(sine, cosine)), "phase": float(np.arctan2(cosine, sine))}


def wave_numbers(motion: Motion, most: int = 400) -> Array:
    """Trial wave numbers 1/period, from one period over the span to `most` half periods over it,
    but no finer than the largest move between samples can show (four samples a period)."""
    span = motion.span
    if span <= 0:
        return np.zeros(0)
    step = float(np.abs(np.diff(motion.x)).max(initial=0.0)) or span
    finest = min(0.25 / step, 0.5 * most / span)
    return np.arange(1.0 / span, max(finest, 1.5 / span), 0.25 / span)
