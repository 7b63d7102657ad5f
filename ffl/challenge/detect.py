"""How visible an effect is: energy of its trace in y after whitening by the true noise spectrum."""

from __future__ import annotations

import numpy as np
import scipy.signal

from ffl.challenge.body import FAMILIES
from ffl.challenge.build import Build
from ffl.challenge.draw import Experiment, Setup
from ffl.challenge.linear import Noise, discrete_zpk


def spectrum(setup: Setup, noise: Noise, n: int) -> np.ndarray:
    """Power of y's noise at the frequencies of an rfft of n samples."""
    z = np.exp(1j * np.pi * np.maximum(np.arange(n // 2 + 1), 0.5) / (n / 2))
    plant = discrete_zpk(setup.true, setup.sample_time).at(z)
    feedback = np.zeros(len(z)) if setup.servo is None else setup.servo.feedback.at(z)
    return noise.density(plant, feedback, z, setup.sample_time)


def whiten(setup: Setup, noise: Noise, traces: list[np.ndarray]) -> np.ndarray:
    """Traces of all fitting recordings as one vector whose squared norm is the energy.

    The energy of the noise itself is one per sample, so an effect's energy is the noncentrality
    of the likelihood-ratio test that knows its shape.
    """
    out = []
    for x in traces:
        window = scipy.signal.windows.tukey(len(x), 0.05)
        root = np.sqrt(spectrum(setup, noise, len(x)) * len(x) / 2)
        f = np.fft.rfft(x * window) / root
        out += [f.real, f.imag]
    return np.concatenate(out)


# Effects that are a parameter of the model grown beyond the contract's line for corrections.
OWN_PARAMETER = {
    "mass_change": "mass",
    "viscous_friction": "viscous",
    "linear_stiffness": "frequency",
}


def tangents(setup: Setup, noise: Noise) -> dict[str, np.ndarray]:
    """What small errors of each nominal parameter do to y, whitened, one vector per parameter."""
    columns = {}
    for key, _ in FAMILIES[setup.family].doubts:
        step = 0.05 if key in ("viscous", "zeta", "z2") else 0.005
        sides = []
        for sign in (1, -1):
            changed = dict(setup.parameters)
            changed[key] *= 1 + sign * step
            build = Build.of(FAMILIES[setup.family].assemble(changed))
            sides.append([_record(build, setup, e, 8)[0] for e in setup.fit])
        columns[key] = whiten(setup, noise, [a - b for a, b in zip(*sides, strict=True)])
    return columns


def _record(build: Build, setup: Setup, e: Experiment, steps: int):
    y, u, *_ = build.run(
        setup.servo, e.reference, e.feedforward, setup.sample_time, steps, start=e.start
    )
    return y[e.skip :], u[e.skip :]


def beyond(vector: np.ndarray, columns: dict[str, np.ndarray], effect: str) -> float:
    """Energy of a whitened trace outside what the nominal parameters can explain.

    The parameter that the effect itself changes does not count: there the size decides.
    """
    kept = [c for key, c in columns.items() if key != OWN_PARAMETER.get(effect)]
    if not kept:
        return float(vector @ vector)
    basis = np.linalg.qr(np.array(kept).T)[0]
    return float(np.sum((vector - basis @ (basis.T @ vector)) ** 2))
