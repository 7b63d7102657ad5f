"""How visible an effect is: energy of its trace in y after whitening by the true noise spectrum."""

from __future__ import annotations

import numpy as np
import scipy.signal

from ffl.challenge.body import FAMILIES
from ffl.challenge.build import Build
from ffl.challenge.draw import Setup
from ffl.challenge.linear import Noise, discrete_zpk

# Effects that are a parameter of the model grown beyond the contract's line for corrections.
OWN_PARAMETER = {
    "mass_change": "mass",
    "viscous_friction": "viscous",
    "linear_stiffness": "frequency",
}
Traces = list[np.ndarray]  # one per fitting recording


class Lens:
    """Sees traces in y of one machine against its noise.

    The energy of a whitened trace is the noncentrality of the likelihood-ratio test that knows
    its shape; the noise itself has energy one per sample.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        plant = discrete_zpk(setup.true, setup.sample_time)
        self.responses = []
        for e in setup.fit:
            n = len(e.reference) - e.skip
            z = np.exp(1j * np.pi * np.maximum(np.arange(n // 2 + 1), 0.5) / (n / 2))
            feedback = np.zeros(len(z)) if setup.servo is None else setup.servo.feedback.at(z)
            window = scipy.signal.windows.tukey(n, 0.05)
            self.responses.append((z, plant.at(z), feedback, window))
        self._tangents: dict[str, Traces] | None = None

    def spectrum(self, noise: Noise, k: int) -> np.ndarray:
        """Power per sample of y's noise at the rfft frequencies of recording k."""
        z, plant, feedback, _ = self.responses[k]
        return noise.density(plant, feedback, z, self.setup.sample_time)

    def whiten(self, noise: Noise, traces: Traces) -> np.ndarray:
        """Traces of all fitting recordings as one vector whose squared norm is the energy."""
        out = []
        for k, x in enumerate(traces):
            root = np.sqrt(self.spectrum(noise, k) * len(x) / 2)
            f = np.fft.rfft(x * self.responses[k][3]) / root
            out += [f.real, f.imag]
        return np.concatenate(out)

    @property
    def tangents(self) -> dict[str, Traces]:
        """What small errors of each nominal parameter do to y."""
        if self._tangents is None:
            self._tangents = {}
            family = FAMILIES[self.setup.family]
            for key, _ in family.doubts:
                step = 0.05 if key in ("viscous", "zeta", "z2") else 0.005
                sides = []
                for sign in (1, -1):
                    changed = dict(self.setup.parameters)
                    changed[key] *= 1 + sign * step
                    sides.append(self._plain(Build.of(family.assemble(changed))))
                self._tangents[key] = [a - b for a, b in zip(*sides, strict=True)]
        return self._tangents

    def _plain(self, build: Build) -> Traces:
        s = self.setup
        return [
            build.run(s.servo, e.reference, e.feedforward, s.sample_time, 8)[0][e.skip :]
            for e in s.fit
        ]

    def beyond(self, noise: Noise, vector: np.ndarray, effect: str) -> float:
        """Energy of a whitened trace outside what the nominal parameters can explain.

        The parameter that the effect itself changes does not count: there the size decides.
        """
        kept = [t for key, t in self.tangents.items() if key != OWN_PARAMETER.get(effect)]
        if not kept:
            return float(vector @ vector)
        basis = np.linalg.qr(np.array([self.whiten(noise, t) for t in kept]).T)[0]
        return float(np.sum((vector - basis @ (basis.T @ vector)) ** 2))
