"""What every hypothesis is judged by: recordings, and the noise in them with its colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ffl.diagnose.contest.work import Work
from ffl.diagnose.hypothesis.coordinate import Coordinate
from ffl.diagnose.hypothesis.model import Model
from ffl.diagnose.noise.lost import filled, mean_power, seen_in, share_seen
from ffl.diagnose.noise.noise import SLOWEST, Noise, fit_noise
from ffl.diagnose.noise.whitening import Whitener
from ffl.diagnose.recorded.trials import Trial
from ffl.systems.loop import Loop
from ffl.systems.state_space import Array

if TYPE_CHECKING:
    from ffl.diagnose.noise.doubt import Doubt

LONG = 0.5  # of the longest calm stretch: noise is read from those at least as long
CALM = 0.2  # of all samples that these must hold
SWINGS = 4.0  # mean square of the whitened residual from which first orders may mislead


def is_far(cost: float, samples: int) -> bool:
    """Whether a sum of squares `cost` is so far from what was measured that first orders may mislead, and
    corrections stand for what is missing."""
    return cost > SWINGS * samples


class Runs(Protocol):
    """What can be simulated beside a recording, with numbers that are free."""

    @property
    def theta(self) -> Array: ...
    @property
    def coordinates(self) -> Sequence[Coordinate]: ...
    @property
    def substeps(self) -> int: ...
    def at(self, theta: Array) -> Runs: ...
    def output(self, trial: Trial) -> Array | None: ...


@dataclass(frozen=True)
class Scene:
    """What every hypothesis is judged by: recordings, the loop that colours noise, the noise."""

    loop: Loop
    trials: tuple[Trial, ...]
    noise: Noise
    floor: float = 0.0
    free_clocks: bool = False  # the recordings' clocks overlap: their offsets are unknown
    worth: float = 1.0  # of a sample, in log-likelihood: less where what is left stays coloured
    plain: bool = False  # no filter of force noise describes what is left: taken as white at y
    loudest: Noise | None = None  # what white noise can be at most, where it is stated
    guess: Noise | None = None  # the same where it is not: for a first look at sets of effects
    doubt: Doubt | None = None  # of recordings that judge: what the fitted ones left open
    slowest: float = SLOWEST  # Hz: lowest corner of coloured noise; what is slower is physics
    observed: bool = False  # an observer closes the loop: noise goes round it in no machine
    work: Work = field(default_factory=Work, repr=False)  # shared by all that come of it

    @cached_property
    def whiteners(self) -> tuple[Whitener, ...]:
        shared: Whitener | None = None
        out = []
        for trial in self.trials:
            lost = trial.lost if trial.lost is not None and trial.lost.any() else None
            if lost is None and not trial.doubt.any():
                shared = shared or Whitener.of(self.loop, self.noise)
                out.append(shared)
            else:
                start = trial.doubt if trial.doubt.any() else None
                out.append(Whitener.of(self.loop, self.noise, start, lost=lost))
        return tuple(out)

    @cached_property
    def log_scale(self) -> float:
        unrest = sum(float(np.log(t.unrest).sum()) for t in self.trials if t.unrest is not None)
        return unrest + sum(
            w.log_scale(len(t)) for w, t in zip(self.whiteners, self.trials, strict=True)
        )

    @property
    def samples(self) -> int:
        return sum(len(t) for t in self.trials)

    def like(self, other: Scene) -> Scene:
        """The scene whitened as `other` is."""
        return replace(self, loop=other.loop, noise=other.noise)

    def head(self, rows: int) -> Scene:
        """The first `rows` samples of the first recording alone."""
        out = replace(self, trials=(self.trials[0].head(rows),))
        object.__setattr__(out, "whiteners", self.whiteners[:1])
        return out

    def residuals(self, model: Runs) -> list[Array] | None:
        """y - yhat of each recording, with nothing of what its sensor lost; None where the simulation
        leaves all bounds."""
        out = []
        self.work.add(self.samples * model.substeps)
        for trial in self.trials:
            y = model.output(trial)
            if y is None:
                return None
            out.append(trial.beside(y))
        return out

    def cost(self, model: Runs) -> float:
        """Sum of squares of the whitened residual; infinite where the simulation leaves all bounds."""
        residuals = self.residuals(model)
        if residuals is None:
            return np.inf
        white = self.whiten(residuals)
        return float(white @ white)

    def whiten(self, residuals: Sequence[Array]) -> Array:
        entries = zip(self.trials, self.whiteners, residuals, strict=True)
        return np.concatenate([trial.weighed(whitener(e)) for trial, whitener, e in entries])

    def judge(self, residuals: Sequence[Array], known: Array | None = None) -> Array:
        """Whitened residuals of recordings that judge, corrections granted what is open of them."""
        white = self.whiten(residuals)
        return white if self.doubt is None else self.doubt.settled(self, white, known)

    def whiten_stacked(self, columns: Array) -> Array:
        """Columns (N, k) over all recordings, whitened together: many at once cost little more
        than one."""
        cuts = np.cumsum([len(t) for t in self.trials])[:-1]
        return self.whiten(np.split(columns, cuts))

    def with_noise_of(
        self, residuals: Sequence[Array], coloured: bool = True, quantile: float | None = None
    ) -> Scene:
        """The scene with the noise that these residuals would be, were they all noise (`quantile`:
        a lower envelope, see `noise.spectrum`)."""
        if self.plain:
            size = float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)))
            return replace(
                self, noise=Noise(max(size, self.floor, 1e-300), 1e-6 * self.noise.force)
            )
        seen = filled(self.whiteners, self.trials, residuals)
        noise = fit_noise(
            self.loop,
            self._calm(seen),
            self.noise,
            floor=self.floor,
            coloured=coloured,
            quantile=quantile,
            slowest=self.slowest,
        )
        noise = noise.scaled(share_seen(self.trials) ** -0.5)  # what was filled in is noise no more
        if quantile is not None and self.loudest is not None:
            sensor, force = self.loudest.sensor, self.loudest.force
            noise = replace(noise, sensor=min(noise.sensor, sensor), force=min(noise.force, force))
        return replace(self, noise=noise)

    def in_own_noise(self, residuals: Sequence[Array]) -> float:
        """Log-likelihood of what is left, were it all noise."""
        own = self.with_noise_of(residuals)
        return own.likeliest(own.whiten(residuals))

    def _calm(self, residuals: Sequence[Array]) -> list[Array]:
        """The stretches of `residuals` in which the linear loop answers noise; where they are few, all,
        turned down by as much as they are loud."""
        if all(t.unrest is None for t in self.trials):
            return list(residuals)
        runs: list[Array] = []
        for trial, e in zip(self.trials, residuals, strict=True):
            loud = np.zeros(len(e), bool) if trial.unrest is None else trial.unrest > 1.0
            edges = np.flatnonzero(np.diff(loud)) + 1
            pieces = zip(np.split(e, edges), np.split(loud, edges), strict=True)
            runs += [run for run, own in pieces if not own[0]]
        longest = max(map(len, runs), default=0)
        runs = [run for run in runs if len(run) >= LONG * longest]
        if sum(map(len, runs)) > CALM * self.samples:
            return runs
        return [t.weighed(e) for t, e in zip(self.trials, residuals, strict=True)]

    def log_likelihood(self, white: Array) -> float:
        return self.worth * float(-0.5 * (white @ white) - self.log_scale)

    def likeliest(self, white: Array) -> float:
        """`log_likelihood` under noise of the size that suits `white` best:
        -n/2 (1 + log(mean square)) - log det."""
        size = max(mean_power(white), 1e-300)
        return self.worth * (-0.5 * seen_in(white) * (1.0 + float(np.log(size))) - self.log_scale)

    def by_free_run(self, model: Model) -> float:
        """`likeliest` of what a free run of `model` leaves; minus infinity where it goes astray."""
        residuals = self.residuals(model)
        return -np.inf if residuals is None else self.likeliest(self.whiten(residuals))
