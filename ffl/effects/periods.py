"""What periodic effects share: harmonics, sine and cosine to amplitude and phase, trial periods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit

from ffl.effects.base import Effect, Extent, Motion, Parameter, Parameters, Setting
from ffl.systems.plant import EffectSpec
from ffl.systems.state_space import Array

AGAIN = 1.5  # periods that the travel holds: half of one is seen twice


@njit(error_model="numpy")
def series(p, x):  # type: ignore[no-untyped-def]
    """sum_i amplitude_i sin(i k x + phase_i) and its derivative by x; harmonics by turning (sin, cos)
    on, one sine and cosine in all.

    p: wave number k, number of harmonics n, then amplitude times (cos, sin) of the phase of each.
    """
    sine, cosine = np.sin(p[0] * x), np.cos(p[0] * x)
    s, c, value, slope = sine, cosine, 0.0, 0.0
    for i in range(int(p[1])):
        along, across = p[2 + 2 * i], p[3 + 2 * i]
        value += along * s + across * c
        slope += (i + 1) * p[0] * (along * c - across * s)
        s, c = s * cosine + c * sine, c * cosine - s * sine
    return value, slope


class Repeating(Effect):
    """What repeats along the position: sum_i amplitude_i sin(2 pi i x/period + phase_i), harmonics named
    amplitude_2, phase_2, ... where there are any."""

    scan = "position"
    valleys = "period"  # first orders may prefer a half of one
    depends_on = ("position",)

    def parameter(self, name: str) -> Parameter:
        stem, _, order = name.partition("_")
        if order.isdigit() and int(order) >= 2 and stem in ("amplitude", "phase"):
            base = super().parameter(stem)
            return Parameter(name, base.unit, base.lower, base.upper, base.linear, 0.0)
        return super().parameter(name)

    def credible(self, spec: EffectSpec, extent: Extent) -> bool:
        """What nothing shows to come again is any force by position."""
        return AGAIN * float(spec.parameters["period"]) <= extent.travel

    def pack(self, values: Parameters, setting: Setting) -> list[float]:
        """The numbers of `series`, forces in input units."""
        pairs = harmonics(values)
        scale = 1.0 / setting.force_per_input if self.port == "force" else 1.0
        parts = [scale * a * turn(phi) for a, phi in pairs for turn in (np.cos, np.sin)]
        return [2 * np.pi / values["period"], float(len(pairs)), *parts]

    def grid(self, motion: Motion) -> list[dict[str, float]]:
        return [{"period": 1.0 / k} for k in wave_numbers(motion)]

    def regressors(self, motion: Motion, **nonlinear: float) -> Array:
        """Sine and cosine over the `period`, then those of its `harmonics` (1: none)."""
        angle = 2 * np.pi * motion.x / nonlinear["period"]
        orders = range(1, int(nonlinear.get("harmonics", 1)) + 1)
        return np.column_stack([turn(k * angle) for k in orders for turn in (np.sin, np.cos)])

    def from_coefficients(self, coefficients, nonlinear):  # type: ignore[no-untyped-def]
        return {**nonlinear, **sine_pair(coefficients)}

    def nonlinear_of(self, values: Parameters) -> dict[str, float]:
        return {"period": values["period"], "harmonics": len(harmonics(values))}

    def coefficients_of(self, values: Parameters) -> Array:
        pairs = harmonics(values)
        return np.array([a * turn(phi) for a, phi in pairs for turn in (np.cos, np.sin)])

    def more(self, values: Parameters) -> str:
        """How a sentence goes on where there are harmonics."""
        count = len(harmonics(values)) - 1
        return f", with {count} more harmonic{'s' if count > 1 else ''}" if count else ""


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
    """Trial wave numbers 1/period, from `AGAIN` periods over the span to `most` half periods over it,
    but no finer than the largest move between samples can show (four samples a period)."""
    span = motion.span
    if span <= 0:
        return np.zeros(0)
    step = float(np.abs(np.diff(motion.x)).max(initial=0.0)) or span
    finest = min(0.25 / step, 0.5 * most / span)
    return np.arange(AGAIN / span, max(finest, (AGAIN + 0.5) / span), 0.25 / span)
