"""Machines as built: a plant whose frequencies, damping and gain are a few per cent off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from ffl.systems.plant import Plant
from ffl.systems.state_space import ComplexArray
from ffl.systems.zpk import CIRCLE_TOLERANCE, Zpk, as_zpk


def mode(frequency: float, damping: float, sample_time: float) -> ComplexArray:
    """Discrete pair exp(s T) of a mode with `frequency` in Hz; negative damping lies outside."""
    w = 2.0 * np.pi * frequency
    s = -damping * w + 1j * w * np.sqrt(1.0 - damping**2)
    root = np.exp(s * sample_time)
    return np.array([root, root.conjugate()])


def _shift(
    roots: ComplexArray, sample_time: float, factor: Generator, low: float, high: float
) -> ComplexArray:
    """Frequency and damping of each root multiplied by 1 +- U(low, high); integrators stay."""

    def off() -> float:
        return 1.0 + float(factor.choice([-1.0, 1.0]) * factor.uniform(low, high))

    moved: list[complex] = []
    for root in roots:
        if root.imag < 0:
            continue
        frequency_off, damping_off = off(), off()
        if abs(root - 1.0) < CIRCLE_TOLERANCE or root == 0:
            moved.append(root)
            continue
        s = np.log(root) / sample_time
        w, damping = abs(s), -s.real / abs(s)
        if root.imag == 0:
            moved.append(complex(np.exp(s.real * frequency_off * sample_time)))
            continue
        pair = mode(w * frequency_off / (2 * np.pi), damping * damping_off, sample_time)
        moved += list(pair)
    return np.array(moved, complex)


def perturbed(
    plant: Plant,
    rng: Generator,
    low: float = 0.02,
    high: float = 0.10,
    left_out_mode: tuple[float, float] | None = (50.0, 80.0),
) -> Plant:
    """A machine that differs from `plant` as real ones do; drawn again until its loop is stable.

    Every frequency, damping and time constant and the low-frequency gain are off by a factor
    1 +- U(low, high). `left_out_mode` adds one lightly damped mode (damping 0.01 to 0.03) with its
    anti-resonance 3 to 8 per cent below, at a frequency drawn from that range in Hz.
    """
    system, t = as_zpk(plant.system), plant.sample_time
    while True:
        zeros = _shift(system.zeros, t, rng, low, high)
        poles = _shift(system.poles, t, rng, low, high)
        gain = system.gain * (1.0 + float(rng.choice([-1.0, 1.0]) * rng.uniform(low, high)))
        gain *= _low_frequency(system.zeros) / _low_frequency(zeros)
        gain *= _low_frequency(poles) / _low_frequency(system.poles)
        if left_out_mode is not None:
            frequency = rng.uniform(*left_out_mode)
            pair = mode(frequency, rng.uniform(0.01, 0.03), t)
            anti = mode(frequency * rng.uniform(0.92, 0.97), rng.uniform(0.01, 0.03), t)
            gain *= _low_frequency(pair) / _low_frequency(anti)
            zeros, poles = np.concatenate([zeros, anti]), np.concatenate([poles, pair])
        machine = replace(
            plant, system=Zpk(zeros, poles, gain, t, system.delay), name=f"{plant.name}_perturbed"
        )
        if machine.controller is None or machine.loop.is_stable:
            return machine


def _low_frequency(roots: ComplexArray) -> float:
    """prod(1 - root) over the roots that are not integrators: the static factor they carry."""
    apart = roots[np.abs(roots - 1.0) > 1e-6]
    return float(np.prod(1.0 - apart).real)
