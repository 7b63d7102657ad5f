"""All periods at once: the adjoint of the loop's filter turns the residual into a force signal, and
sums of it against exp(2 pi i x/period) or exp(2 pi i f t) tell which periods deserve a closer look.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft

from ffl.effects import Effect, Motion
from ffl.systems.state_space import Array

if TYPE_CHECKING:
    from ffl.diagnose.hypothesis.places import Place
from ffl.diagnose.screen.screen import Screen

PASSES = 2.0  # of a sine within the recording: of fewer nothing is seen to repeat
PLACES = 1.0  # the same within the travel
LEVELS = 3.0  # the same in a process, where a bend of any kind is nearly a sine of few periods
PEAKS = 6
FLOOR = 1e-9  # of the largest norm: below it the loop passes nothing on, and rounding would win


def adjoint(residual: Array, impulse: Array) -> Array:
    """sum over tau of h(tau) e(t + tau)."""
    n = scipy.fft.next_fast_len(len(residual) + len(impulse) - 1, real=True)
    spectrum = scipy.fft.rfft(residual, n) * np.conj(scipy.fft.rfft(impulse, n))
    return scipy.fft.irfft(spectrum, n)[: len(residual)]


def periods(screen: Screen, effect: Effect, place: Place) -> list[Mapping[str, float]]:
    """Values of the scanned parameter worth an exact look, refined between grid points."""
    motions = screen.motions(place)
    impulses = screen.passage.impulses(place)
    lengths = [len(m.t) for m in motions]
    pieces = np.split(screen.residual, np.cumsum(lengths)[:-1])
    forces = [adjoint(e, h) for e, h in zip(pieces, impulses, strict=True)]
    power = _Power(impulses[0], motions[0].sample_time)
    fewest = LEVELS if screen.model.base.is_process else PLACES
    if effect.scan == "time":
        name, numbers, score = "frequency", *_over_time(motions, forces, power)
    else:
        name, numbers, score = "period", *_over_position(motions, forces, power, fewest)
    if not len(numbers):
        return []
    inner = (score[1:-1] >= score[:-2]) & (score[1:-1] >= score[2:])
    peaks = np.flatnonzero(np.r_[score[0] > score[1:2].max(initial=0), inner, False])
    best = peaks[np.argsort(-score[peaks])][:PEAKS]
    step = numbers[1] - numbers[0] if len(numbers) > 1 else numbers[0]
    fine = [numbers[k] + step * s for k in best for s in (-0.6, -0.3, 0.0, 0.3, 0.6)]
    wanted = [k for k in fine if k > 0]
    return [{name: float(k if name == "frequency" else 1.0 / k)} for k in wanted]


class _Power:
    """|H|^2 over frequency."""

    def __init__(self, impulse: Array, sample_time: float) -> None:
        n = 1 << max(10, int(np.ceil(np.log2(len(impulse)))))
        self.frequencies = scipy.fft.rfftfreq(n, sample_time)
        self.values = np.abs(scipy.fft.rfft(impulse, n)) ** 2

    def __call__(self, frequency: Array) -> Array:
        return np.interp(frequency, self.frequencies, self.values)


def _over_time(motions: list[Motion], forces: list[Array], power: _Power) -> tuple[Array, Array]:
    longest = max(len(f) for f in forces)
    n = 4 * scipy.fft.next_fast_len(longest)
    step = motions[0].sample_time
    frequencies = scipy.fft.rfftfreq(n, step)
    score = np.zeros(len(frequencies))
    total = sum(len(f) for f in forces)
    for force in forces:
        score += np.abs(scipy.fft.rfft(force, n)) ** 2 / len(force)
    norm = 0.5 * power(frequencies)
    score = score / np.maximum(norm, FLOOR * norm.max()) * (len(forces) * longest / total)
    usable = (frequencies > PASSES / (longest * step)) & (frequencies < 0.4 / step)
    return frequencies[usable], score[usable]


def _over_position(
    motions: list[Motion], forces: list[Array], power: _Power, fewest: float
) -> tuple[Array, Array]:
    joined_x = np.concatenate([m.x for m in motions])
    speed = np.abs(np.concatenate([m.v for m in motions]))
    force = np.concatenate(forces)
    # Jumps between recordings are not moves between samples. Positions are known whatever the speed,
    # so a period may pass in few samples of the fastest motion, as long as most of it shows more.
    moves = np.concatenate([np.abs(np.diff(m.x)) for m in motions])
    usual = float(np.median(moves[moves > 0.05 * moves.max(initial=0.0)])) if moves.any() else 0.0
    numbers = np.arange(fewest, 400.0, 0.25) / max(np.ptp(joined_x), 1e-300)
    numbers = numbers[numbers < max(0.5 / max(usual, 1e-300), numbers[2])]
    if not len(numbers):
        return numbers, numbers
    # Speeds in classes: the norm needs |H|^2 at speed * wave number only.
    levels = np.quantile(speed, np.linspace(0.01, 0.99, 40))
    turn = np.exp(2j * np.pi * joined_x * (numbers[1] - numbers[0] if len(numbers) > 1 else 0.0))
    wave = np.exp(2j * np.pi * joined_x * numbers[0]) * force
    norms = power(np.outer(numbers, levels)).mean(axis=1)
    score = np.empty(len(numbers))
    for k, norm in enumerate(0.5 * len(force) * norms):
        score[k] = abs(wave.sum()) ** 2 / max(norm, 1e-300)
        wave *= turn
    return numbers, score * np.minimum(1.0, norms / (FLOOR * norms.max()))
