"""How visible an effect is: energy of its trace in y after whitening by the true noise spectrum."""

from __future__ import annotations

import numpy as np

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
ROOM = 8  # times a recording's length: of what the filter's memory fades over
FADED = 1e-6
# Of the lowest frequency, what stands for zero, where a loop may pass no noise: with it the mean of
# log|1 - 1/z| over the grid is what it is over the circle, none.
NEAR_REST = 1.0 / (2.0 * np.pi)
ROUNDS, SETTLED = 12, 1e-3  # of Gauss and Newton; decrease of the energy by which it has arrived


class Lens:
    """Sees traces in y of one machine against its noise.

    The energy of a whitened trace is the noncentrality of the likelihood-ratio test that knows
    its shape; the noise itself has energy one per sample. Traces reach from where the machine starts
    to the end of the recording, (skip + N,): what an effect left before the first sample is the past
    of what it leaves in the recording, and only that part, (N,), counts.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        plant = discrete_zpk(setup.true, setup.sample_time)
        self.responses = []
        for e in setup.fit:
            n = 1 << int(np.ceil(np.log2(ROOM * len(e.reference))))
            z = np.exp(2j * np.pi * np.maximum(np.arange(n // 2 + 1), NEAR_REST) / n)
            feedback = np.zeros(len(z)) if setup.servo is None else setup.servo.feedback.at(z)
            self.responses.append((z, plant.at(z), feedback))
        self._factors: dict[tuple[Noise, int], np.ndarray] = {}
        self._tangents: dict[str, Traces] | None = None

    def spectrum(self, noise: Noise, k: int) -> np.ndarray:
        """Power per sample of y's noise at frequencies evenly spread over recording k's band."""
        z, plant, feedback = self.responses[k]
        return noise.density(plant, feedback, z, self.setup.sample_time)

    def whiten(self, noise: Noise, traces: Traces) -> np.ndarray:
        """The recorded part of all traces as one vector whose squared norm is the energy, filtered by the
        inverse of the noise's `factor`.

        A windowed periodogram in its place leaks: of a constant offset in a slow loop, whose noise
        falls with the fourth power of frequency, it sees the edges, with twenty times the energy.
        Traces and filter fade alike, by FADED over the grid, so that an integrator's memory does not
        come round.
        """
        out = []
        for k, x in enumerate(traces):
            factor = self.factor(noise, k)
            n, rows = 2 * (len(factor) - 1), len(x)
            fade = FADED ** (np.arange(rows) / n)
            faded = np.fft.irfft(np.fft.rfft(x * fade, n) / factor, n)[:rows]
            out.append((faded / fade)[self.setup.fit[k].skip :])
        return np.concatenate(out)

    def factor(self, noise: Noise, k: int) -> np.ndarray:
        """H of recording k, fading: causal with a causal inverse, |H|^2 the noise's spectrum. By the
        cepstrum: log H holds what of log|H|^2 lies at positive times, and half of that at zero."""
        if (noise, k) not in self._factors:
            cepstrum = np.fft.irfft(np.log(self.spectrum(noise, k)))
            n = len(cepstrum)
            cepstrum[0] *= 0.5
            cepstrum[n // 2 :] = 0.0
            self._factors[noise, k] = np.exp(np.fft.rfft(cepstrum * FADED ** (np.arange(n) / n)))
        return self._factors[noise, k]

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
        return [build.run(s.servo, e.reference, e.feedforward, s.sample_time, 8)[0] for e in s.fit]

    def beyond(self, noise: Noise, vector: np.ndarray, effect: str) -> float:
        """Energy of a whitened trace outside what the nominal parameters can explain.

        The parameter that the effect itself changes does not count: there the size decides.
        """
        kept = [t for key, t in self.tangents.items() if key != OWN_PARAMETER.get(effect)]
        if not kept:
            return float(vector @ vector)
        basis = np.linalg.qr(np.array([self.whiten(noise, t) for t in kept]).T)[0]
        return float(np.sum((vector - basis @ (basis.T @ vector)) ** 2))

    def beyond_moved(self, noise: Noise, runs: Traces) -> float:
        """Energy of y in `runs` that the model without effects leaves with its parameters moved as far as
        it takes, by Gauss and Newton; at most what it leaves as it is.

        `beyond` is of first order. A mode of a tenth of the mass near a resonance of the model has 12,171
        beyond the nominal parameters by that, and none once the resonance moves by 14 %.
        """
        keys = [key for key, _ in FAMILIES[self.setup.family].doubts]

        def left(x: np.ndarray) -> np.ndarray:
            moved = dict(self.setup.parameters)
            for key, value in zip(keys, x, strict=True):
                moved[key] *= np.exp(value)
            plain = self._plain(Build.of(FAMILIES[self.setup.family].assemble(moved)))
            e = self.whiten(noise, [a - b for a, b in zip(runs, plain, strict=True)])
            return np.where(np.isfinite(e), e, 1e6)

        x = np.zeros(len(keys))
        e = left(x)
        for _ in range(ROUNDS):
            columns = [(left(x + step) - left(x - step)) / 2e-3 for step in 1e-3 * np.eye(len(x))]
            way = np.linalg.lstsq(np.array(columns).T, -e, rcond=1e-9)[0]
            tried = [(scale, left(x + scale * way)) for scale in (1.0, 0.5, 0.25, 0.1)]
            scale, best = min(tried, key=lambda pair: float(pair[1] @ pair[1]))
            if not best @ best < (1.0 - SETTLED) * (e @ e):
                break
            x, e = x + scale * way, best
        return float(e @ e)
