"""What comes back in every recording at the same time since its beginning, whatever the machine does.

A rotor that spins up, a press beside the machine that is started with it: no motion repeats it, and it
passes for noise, however loud. But noise does not come twice. Recordings of other motions whose residuals
go together, sample by sample, share a disturbance that goes by the time; what the fitted ones have in
common is run in those that judge. Recordings of one motion say nothing of it: there everything repeats.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.signal import fftconvolve

from ffl.diagnose.contest.scene import Scene
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.least import least_noise
from ffl.diagnose.noise.wiener import Wiener
from ffl.diagnose.recorded.trials import Trial
from ffl.effects import Motion
from ffl.systems.state_space import Array

TOGETHER = 0.7  # least correlation of what two recordings of other motions leave
ALIKE = 0.5  # correlation of any signal of two motions, from which they are no others
LEAST = 400  # samples that recordings must have in common
OVER = 0.6  # of the longest recording, that a common part must be
LEFT = 0.5  # of the mean square of each recording that judges, that what is common leaves at most
CORNERS = (3.0, 10.0, 30.0, 100.0, 300.0)  # periods in a recording, below which it is looked for
SLOWER = 1.5  # times the squares that another corner leaves: what a lower one may, which draws less noise
BINS = 15  # of the spectrum, over which what recordings share is averaged
SMOOTH = (
    11  # samples over which it is smoothed for a first look at its turns, then a third of a turn
)
TURNS = 10  # that an oscillation takes at least
FEW = 2  # turns that tell how fast it comes and goes
SWEEPS = 1.3  # times as fast in the end as at first, or the reverse
EDGE = 20  # samples in the end: what acted there has hardly moved anything yet
EVENLY = 0.25  # of a turn, by which half of all turns differ from the one before at most


@dataclass(frozen=True)
class Repeating:
    """`load` (n,): the common part as a force beside the command, input units; `each` (k, n): the same of
    every recording by itself; `correlation`: the least of two recordings; `left`: of the mean square of the
    recordings that judge; `error`: RMS of y that is left there."""

    load: Array
    each: Array
    sample_time: float
    correlation: float
    left: float
    error: float

    @property
    def gain(self) -> float:
        """Log-likelihood of a recording, were its samples independent."""
        return -0.5 * len(self.load) * float(np.log(self.left))

    @property
    def t(self) -> Array:
        return self.sample_time * np.arange(len(self.load))

    @property
    def words(self) -> str:
        said = (
            "a disturbance that is the same in every recording at the same time since its beginning, "
            f"whatever the machine does (correlation {self.correlation:.3f})"
        )
        if self.hertz is None:
            return said
        first, last = self.hertz
        return f"{said}: it oscillates, at {first:.3g} Hz at first and at {last:.3g} Hz in the end"

    @property
    def hertz(self) -> tuple[float, float] | None:
        """How fast it oscillates at first and in the end; None where it does not."""
        turns = self._turns
        return None if turns is None else (1.0 / turns[:FEW].mean(), 1.0 / turns[-FEW:].mean())

    @property
    def sweeps(self) -> bool:
        """It oscillates faster and faster, or slower and slower: nothing of the catalogue does."""
        first, last = self.hertz or (1.0, 1.0)
        return max(first / last, last / first) > SWEEPS

    @property
    def _turns(self) -> Array | None:
        """How long each turn of an oscillation takes, s; None where it is none."""
        turns = self._between_zeros(SMOOTH)
        if len(turns) < TURNS:
            return None
        turns = self._between_zeros(int(np.median(turns) / self.sample_time / 3.0))
        if len(turns) < TURNS or np.median(np.abs(np.diff(turns)) / turns[1:]) > EVENLY:
            return None
        return turns

    def _between_zeros(self, samples: int) -> Array:
        """Seconds between one passage upward and the next, smoothed over `samples`."""
        window = np.hanning(max(samples, 1) + 2)[1:-1]
        x = fftconvolve(self.load - self.load.mean(), window / window.sum(), "same")
        up = np.flatnonzero((x[:-1] < 0.0) & (x[1:] >= 0.0))
        return np.diff(up + x[up] / (x[up] - x[up + 1])) * self.sample_time

    def loaded(self, trials: Sequence[Trial]) -> tuple[Trial, ...]:
        """`trials` with it beside the command; nothing beyond what the recordings have in common."""
        out = []
        for trial in trials:
            n = min(len(trial), len(self.load))
            own = np.zeros(len(trial)) if trial.load is None else trial.load.copy()
            own[:n] += self.load[:n]
            out.append(replace(trial, load=own))
        return tuple(out)


def repeating(scene: Scene, held: Scene | None, model: Model) -> Repeating | None:
    """What `model` leaves of all recordings at the same times; None where they share nothing, or cannot
    say."""
    if held is None or scene.observed or not _whole([*scene.trials, *held.trials]):
        return None
    judging = held.like(scene)
    left, missed = scene.residuals(model), judging.residuals(model)
    if not left or not missed:
        return None
    everything = [*scene.trials, *held.trials]
    n = min(map(len, everything))
    if n < max(LEAST, OVER * max(map(len, everything))):
        return None
    quiet = replace(scene, noise=least_noise(scene, model, left))
    white = [
        ground.whiteners[k](e)[:n]
        for ground, some in ((quiet, left), (judging.like(quiet), missed))
        for k, e in enumerate(some)
    ]
    motions = [model.follow(trial).motion() for trial in everything]
    pairs = [
        (i, j)
        for i, j in combinations(range(len(white)), 2)
        if not _alike(motions[i], motions[j], n)
    ]
    together = [_correlation(white[i], white[j]) for i, j in pairs]
    fitted = len(scene.trials)
    across = any(i < fitted <= j for i, j in pairs)
    if not across or min(together) < TOGETHER:
        return None
    behind = Wiener(quiet, n)
    size = float(np.mean(np.concatenate([t.u[:n] for t in everything]) ** 2))
    step, corr = scene.loop.system.sample_time, min(together)
    ways = []
    for corner in CORNERS:
        each = np.array([behind(e[:n], size, corner / (n * step)) for e in (*left, *missed)])
        found = Repeating(_common(each[:fitted]), each, step, corr, 1.0, 0.0)
        after = replace(quiet, trials=found.loaded(quiet.trials)).residuals(model)
        if after is not None:
            ways.append((float(np.sum(quiet.whiten(after) ** 2)), found))
    if not ways:
        return None
    judged, least = judging.like(quiet), SLOWER * min(cost for cost, _ in ways)
    found = next(way for cost, way in ways if cost <= least)
    after = replace(judged, trials=found.loaded(judged.trials)).residuals(model)
    if after is None:
        return None
    shares = [
        float(np.mean(w(a)[:n] ** 2) / np.mean(w(b)[:n] ** 2))
        for w, a, b in zip(judged.whiteners, after, missed, strict=True)
    ]
    error = float(np.sqrt(np.mean(np.concatenate(after) ** 2)))
    return replace(found, left=max(shares), error=error) if max(shares) < LEFT else None


def _common(each: Array) -> Array:
    """The mean of the recordings (k, n), less what they do not share frequency by frequency: of the power
    S + N of each, and S + N/k of the mean, S is theirs in common."""
    k, n = each.shape
    mean = each.mean(axis=0)
    if k < 2:
        return mean
    spectra = np.fft.rfft(each, 2 * n)
    whole, shared = (
        fftconvolve(power, np.ones(BINS) / BINS, "same")
        for power in ((np.abs(spectra) ** 2).mean(axis=0), np.abs(spectra.mean(axis=0)) ** 2)
    )
    share = np.clip((k * shared - whole) / (k - 1) / np.maximum(shared, 1e-300), 0.0, 1.0)
    shared = np.fft.irfft(share * np.fft.rfft(mean, 2 * n), 2 * n)[:n]
    shared[-EDGE:] = 0.0
    return shared


def _whole(trials: Sequence[Trial]) -> bool:
    """Recordings that each begin where they began, not pieces of one another, with their command."""
    names = [trial.name for trial in trials]
    known = all(np.all(np.isfinite(t.u)) and t.lost is None and not t.folded for t in trials)
    return known and len(set(names)) == len(names) > 1


def _alike(a: Motion, b: Motion, n: int) -> bool:
    """Whether two motions are one as far as any signal goes that physics may go by."""
    signals = ("x", "v", "a", "u")
    pairs = [(getattr(a, s)[:n], getattr(b, s)[:n]) for s in signals]
    pairs.append((np.sign(a.v[:n]), np.sign(b.v[:n])))
    return any(abs(_correlation(p - p.mean(), q - q.mean())) > ALIKE for p, q in pairs)


def _correlation(a: Array, b: Array) -> float:
    return float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300)
